"""Whether the scans of a topic can be placed: the transforms from their frame to the robot and to its odometry."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pc2scan.errors import TransformError

from .scan_topic import Finding, Tally, finding

if TYPE_CHECKING:
    from pc2scan.tf.buffer import TransformBuffer

    from .scan_topic import Level

__all__ = ["BASE_FRAMES", "ScanFrames", "no_transforms"]

#: What a robot's body is usually called, the first that is there.
BASE_FRAMES = ("base_link", "base_footprint")

#: gmapping refuses a laser whose z axis has this much less than 1 of the robot's: 2.6 degrees.
_TILT = 0.001

_HINT = "`pc2scan tf` shows the frames; `tf_from` takes transforms from another recording"


def no_transforms() -> Finding:
    """What is told of a recording without any transforms."""
    return Finding(
        "no-transforms",
        "notice",
        "the recording has no transforms: SLAM needs them from the scan's frame to odometry",
        "keep /tf and /tf_static when recording or converting; `tf_from` takes them from another recording",
    )


class ScanFrames:
    """The transforms that the scans of one topic need, looked up scan by scan.

    Parameters
    ----------
    buffer
        Every transform of the recording.
    odom_frame
        Where the robot drives.
    base_frame
        The robot's body; empty for the first of `BASE_FRAMES` that is there.
    """

    def __init__(self, buffer: TransformBuffer, odom_frame: str, base_frame: str = "") -> None:
        self._buffer = buffer
        known = set(buffer.frames)
        self._odom = odom_frame.removeprefix("/")
        self._base = base_frame.removeprefix("/") or next((f for f in BASE_FRAMES if f in known), BASE_FRAMES[0])
        self._trees = {frame: number for number, tree in enumerate(buffer.trees) for frame in tree.frames}
        self._scans: dict[str, int] = {}
        self._missing: dict[str, Tally] = {}
        self._reasons: dict[str, str] = {}
        self._tilted = Tally()
        self._tilt = 0.0

    def add(self, frame_id: str, stamp_ns: int) -> None:
        """Look up one scan's transforms."""
        frame = frame_id.removeprefix("/")
        self._scans[frame] = self._scans.get(frame, 0) + 1
        if self._joined(frame, self._odom):
            try:
                self._buffer.lookup(self._odom, frame, stamp_ns)
            except TransformError as err:
                self._missing.setdefault(frame, Tally()).add(stamp_ns)
                self._reasons.setdefault(frame, err.message)
        if self._joined(frame, self._base):
            try:
                moved = self._buffer.lookup(self._base, frame, stamp_ns)
            except TransformError:
                return
            # Upside down is level too.
            level = min(abs(float(moved.matrix[2, 2])), 1.0)
            if level < 1 - _TILT:
                self._tilted.add(stamp_ns)
                self._tilt = max(self._tilt, math.degrees(math.acos(level)))

    def _joined(self, one: str, other: str) -> bool:
        tree = self._trees.get(one)
        return tree is not None and tree == self._trees.get(other)

    def findings(self) -> list[Finding]:
        """What is missing."""
        found = []
        roles: tuple[tuple[str, str, str, Level], ...] = (
            ("odometry", self._odom, "odom_frame", "defect"),
            ("robot", self._base, "base_frame", "notice"),
        )
        for role, name, option, level in roles:
            if name not in self._trees:
                there = ", ".join(root for tree in self._buffer.trees for root in tree.roots)
                found.append(
                    Finding(
                        f"no-{role}-frame",
                        level,
                        f"there is no frame {name!r} ({role}) in the transforms; their roots: {there}",
                        f"`{option}` names the one that is meant; {_HINT}",
                    )
                )
        for frame, scans in self._scans.items():
            # An empty name is told with the scans themselves.
            if frame:
                found += self._frame_findings(frame, scans)
        if self._tilted.count:
            found.append(
                finding(
                    "tilted",
                    "notice",
                    f"{self._tilted.count:,} scans are tilted against {self._base}, by up to {self._tilt:.1f} deg: "
                    "2D SLAM takes them for level, and gmapping does not start with them",
                    "for scans made from clouds: pc2scan convert --target-frame",
                    self._tilted,
                )
            )
        return found

    def _frame_findings(self, frame: str, scans: int) -> list[Finding]:
        if frame not in self._trees:
            text = f"the scan's frame {frame!r} is not in the transforms"
            return [Finding("frame-unknown", "defect", text, _HINT, scans)]
        found = []
        apart = [name for name in (self._odom, self._base) if name in self._trees and not self._joined(frame, name)]
        if apart:
            text = f"the scan's frame {frame!r} is not connected with {' or '.join(map(repr, apart))}"
            found.append(Finding("frame-apart", "defect" if self._odom in apart else "notice", text, _HINT, scans))
        missing = self._missing.get(frame)
        if missing is not None:
            share = f"{missing.count:,} of {scans:,} scans"
            text = f"{share} have no transform from {frame!r} to {self._odom!r} at their stamp"
            if missing.count < scans:
                hint = "a few at the beginning and the end are usual, and SLAM drops them; " + _HINT
                found.append(finding("no-transform", "notice", text, hint, missing))
            else:
                found.append(finding("no-transform", "defect", f"{text}: {self._reasons[frame]}", _HINT, missing))
        return found
