"""Checks the frames of scans: their transforms to the robot and to its odometry, and whether they are level."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.advice.odometry import odometry_of
from pc2scan.core.consumers import NO_TRANSFORMS
from pc2scan.core.layout import TURN
from pc2scan.core.rigid import Rigid
from pc2scan.core.verdicts import ScanTransforms
from pc2scan.errors import TransformError
from pc2scan.text import counted, nearest
from pc2scan.transforms.lookup_errors import mount_text, named_in_namespace
from pc2scan.transforms.placing import Placer
from pc2scan.transforms.summary import BODIES
from pc2scan.transforms.world_frames import find_body_motion

from .findings import Finding, Tally, few_unplaced, finding

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from pc2scan.advice.clocks import ClockFinding
    from pc2scan.advice.survey import TopicFacts
    from pc2scan.transforms.buffer import TransformBuffer

    from .arrivals import Arrivals
    from .findings import Level

#: A sensor is tilted if the cosine between its z axis and the robot's is below 1 by this much: 2.6 degrees.
_TILT = 0.001

#: A frame's z axis is not up if the cosine between it and the robot's is below this: 45 degrees and more.
_SIDEWAYS = math.sqrt(0.5)

#: The names of camera frames, whose z axis points forward (REP 103).
_OPTICAL = ("_optical_frame", "_optical")

#: The options that name the frames.
_OPTIONS = {"odometry": "odom_frame", "robot": "base_frame"}

_HINT = "`pc2scan tf` shows the frames; `tf_from` reads transforms from another recording"


def _no_transforms() -> Finding:
    """Return the finding about a recording without any transforms."""
    return Finding(
        "no-transforms",
        "notice",
        "the recording has no transforms: SLAM and navigation drop scans that they cannot place",
        NO_TRANSFORMS,
    )


class _Pose(NamedTuple):
    """Where a scan's frame is on the robot, as far as 2D consumers see it: metres, radians."""

    x: float
    y: float
    yaw: float

    @classmethod
    def of(cls, base_from_scan: Rigid, matrix: NDArray[np.float64]) -> _Pose:
        x, y, _ = (float(part) for part in base_from_scan.translation)
        return cls(x, y, math.atan2(float(matrix[1, 0]), float(matrix[0, 0])))

    def since(self, first: _Pose) -> tuple[float, float]:
        """Return how far the frame has turned and moved since it had another pose."""
        return math.remainder(self.yaw - first.yaw, TURN), math.hypot(self.x - first.x, self.y - first.y)


class ScanFrames:
    """The transforms that the scans of one topic need, looked up scan by scan.

    Parameters
    ----------
    buffer
        All transforms of the recording.
    odom_frame
        The frame in which the robot drives.
    base_frame
        The robot's body; empty for the first of `BODIES` that exists.
    clock
        What is wrong with the clock of the scans, compared with that of the transforms; None if nothing is.
    arrivals
        When the transforms were logged; None: scans do not wait for them.
    """

    def __init__(
        self,
        buffer: TransformBuffer,
        odom_frame: str,
        base_frame: str = "",
        clock: ClockFinding | None = None,
        arrivals: Arrivals | None = None,
    ) -> None:
        self._buffer = buffer
        known = set(buffer.frames)
        self._odom = odom_frame.removeprefix("/")
        self._base = base_frame.removeprefix("/") or next((f for f in BODIES if f in known), BODIES[0])
        self._trees = {frame: number for number, tree in enumerate(buffer.trees) for frame in tree.frames}
        self._scans: dict[str, int] = {}
        self._missing: dict[str, Tally] = {}
        #: Why the first transform is missing, and what to do.
        self._reasons: dict[str, tuple[str, str]] = {}
        self._looked = 0
        self._tilted, self._sideways = Tally(), Tally()
        self._tilt = 0.0
        self._first_poses: dict[str, _Pose] = {}
        self._named = bool(base_frame)
        self._clock = clock
        self._arrivals = arrivals
        #: The frames that move between a scan's and the odometry's.
        self._moving: dict[str, list[str]] = {}
        #: The last scan: its stamp, and when its transform was known.
        self._waiting = (0, 0)
        self._late = Tally()

    def add(self, frame_id: str, stamp_ns: int, log_time_ns: int = 0) -> ScanTransforms:
        """Look up one scan's transforms; scans are added in the order of their log times."""
        frame = frame_id.removeprefix("/")
        earlier_ns, known_ns = self._waiting
        if known_ns > log_time_ns > 0:
            self._late.add(earlier_ns)
        self._scans[frame] = self._scans.get(frame, 0) + 1
        odometry, missing, hint = self._moved(frame, self._odom, stamp_ns)
        if odometry is None and self._joined(frame, self._odom):
            self._missing.setdefault(frame, Tally()).add(stamp_ns)
            self._reasons.setdefault(frame, (missing, hint))
        self._waiting = stamp_ns, 0 if odometry is None else self._known_ns(frame, stamp_ns)
        robot, why, how = self._moved(frame, self._base, stamp_ns)
        known: bool | None = robot is not None
        if robot is None and self._trees and self._base not in self._trees and not self._named:
            # The name of the robot's frame is unknown.
            known = None
        up, turned, moved = None, 0.0, 0.0
        if robot is not None:
            matrix = robot.matrix
            up = self._up(robot, matrix, stamp_ns)
            if odometry is not None:
                pose = _Pose.of(robot, matrix)
                turned, moved = pose.since(self._first_poses.setdefault(frame, pose))
        return ScanTransforms(
            frame_id=frame_id,
            odometry=odometry is not None,
            robot=known,
            up=up,
            turned=turned,
            moved=moved,
            missing=missing or why,
            cure="" if odometry is not None and known is not False else self._cure(frame, hint or how),
        )

    def _known_ns(self, frame: str, stamp_ns: int) -> int:
        """Return the log time from which on a frame's transform to the odometry was known at a stamp; 0: always."""
        if self._arrivals is None:
            return 0
        if frame not in self._moving:
            links = self._buffer.moving_links(self._odom, frame)
            self._moving[frame] = [self._buffer.frames[link.child] for link in links]
        return self._arrivals.known_ns(self._moving[frame], stamp_ns)

    def _cure(self, frame: str, hint: str) -> str:
        """Return what gives scans the transforms that they lack; empty if only recording them does.

        Parameters
        ----------
        hint
            That of the transform's error.
        """
        if not frame or not self._trees:
            return ""
        if frame not in self._trees:
            near = nearest(frame, self._trees)
            if near:
                return f"did you mean {near}? For scans made from clouds: pc2scan convert `source_frame={near}`"
            return f"for scans made from clouds: pc2scan convert {mount_text(frame, self._trees)}"
        return self._naming("odometry", self._odom) if self._odom not in self._trees else hint

    @property
    def _robot_moves(self) -> bool:
        """Whether the robot moves in a frame; if its own is not known, whether anything moves."""
        tree = self._trees.get(self._base)
        if tree is None:
            return not all(info.static for info in self._buffer.infos)
        return any(self._buffer.moving_links(root, self._base) for root in self._buffer.trees[tree].roots)

    def _naming(self, role: str, name: str) -> str:
        """Return what to do if there is no frame of this name."""
        option = _OPTIONS[role]
        if namesake := named_in_namespace(name, self._trees):
            return f"`{option}={namesake}`"
        if role == "odometry" and not self._robot_moves:
            return (
                "record the robot's odometry on /tf, or a SLAM that needs none; pc2scan convert `odom_topic=/odom` or "
                f"`trajectory=poses.tum` writes it to /tf; {_HINT}"
            )
        return f"`{option}` names the right one; {_HINT}"

    def _moved(self, frame: str, target: str, stamp_ns: int) -> tuple[Rigid | None, str, str]:
        """Return the transform to a frame at a stamp; or None, why there is none, and what to do."""
        if frame == target:
            return Rigid.identity(), "", ""
        if not self._trees:
            return None, "the recording has no transforms", ""
        try:
            return self._buffer.lookup(target, frame, stamp_ns), "", ""
        except TransformError as err:
            # A tolerance places scans, but does not give consumers a transform at their stamps.
            return None, err.message, self._gap_cure if err.gap_ns else err.hint or ""

    @property
    def _gap_cure(self) -> str:
        """What to do if there are no transforms at the time of scans."""
        if self._clock is not None:
            option = f"`time_offset={self._clock.time_offset}`"
            return f"the clocks differ; for scans made from clouds: pc2scan convert {option}"
        return (
            "record /tf as long as the scans; for scans made from clouds, pc2scan convert `start` and `end` leave out "
            f"those without; {_HINT}"
        )

    def _up(self, base_from_scan: Rigid, matrix: NDArray[np.float64], stamp_ns: int) -> float:
        """See `ScanTransforms.up`; counts how the sensor is tilted."""
        ahead, left, up = (float(part) for part in matrix[:, 2])
        # A sensor that is upside down is level, too.
        level = min(abs(up), 1.0)
        self._looked += 1
        if level < _SIDEWAYS:
            self._sideways.add(stamp_ns)
        if level < 1 - _TILT:
            self._tilted.add(stamp_ns)
        self._tilt = max(self._tilt, math.degrees(math.acos(level)))
        # Like gmapping, which transforms (0, 0, 1 + the sensor's height) from the robot's frame to the scan's.
        x, y, _ = (float(part) for part in base_from_scan.translation)
        return up - x * ahead - y * left

    def _joined(self, one: str, other: str) -> bool:
        tree = self._trees.get(one)
        return tree is not None and tree == self._trees.get(other)

    def findings(self, interval_ns: float | None) -> list[Finding]:
        """Return the problems, given the median interval between scans."""
        if not self._trees:
            return [_no_transforms(), *self._optical_findings()]
        found = []
        if self._clock is not None:
            found.append(Finding("clock", "notice", self._clock.text, self._gap_cure))
        levels: tuple[Level, Level] = ("defect", "notice")
        for role, name, level in zip(_OPTIONS, (self._odom, self._base), levels, strict=True):
            if name not in self._trees:
                there = ", ".join(root for tree in self._buffer.trees for root in tree.roots)
                text = f"there is no frame {name!r} ({role}) in the transforms; their roots: {there}"
                if role == "odometry" and not self._robot_moves:
                    text += "; the robot does not move in them"
                found.append(Finding(f"no-{role}-frame", level, text, self._naming(role, name)))
        odometry = odometry_of(self._buffer, self._odom, self._base)
        if odometry.fault:
            found.append(Finding("odometry-direction", "defect", odometry.fault, f"pc2scan convert {odometry.cure}"))
        for frame, scans in self._scans.items():
            # An empty name is reported with the scans themselves.
            if frame:
                found += self._frame_findings(frame, scans, interval_ns)
        scans = sum(self._scans.values())
        if self._late.count and not few_unplaced(self._late.count, scans, interval_ns):
            text = (
                f"{self._late.count:,} of {counted(scans, 'scan')} have their transform to {self._odom!r} logged only "
                "after the next scan: a message filter with a queue of one, as slam_toolbox has, drops them"
            )
            hint = "publish the transforms sooner, or give slam_toolbox a larger scan_queue_size"
            level = "defect" if 2 * self._late.count >= scans else "notice"
            found.append(finding("transforms-late", level, text, hint, self._late))
        optical = self._optical_findings()
        found += optical
        if self._tilted.count and not optical:
            found.append(
                finding(
                    "tilted",
                    "notice",
                    f"{counted(self._tilted.count, 'scan', 'are')} tilted against {self._base}, "
                    f"by up to {self._tilt:.1f} deg: 2D SLAM treats them as level",
                    "for scans made from clouds: pc2scan convert `target_frame`",
                    self._tilted,
                )
            )
        return found

    def _optical_findings(self) -> list[Finding]:
        hint = "for scans made from clouds: pc2scan convert `target_frame=base_link`; a scan lies in the x-y plane"
        # A tilting lidar points sideways for a moment.
        if 2 * self._sideways.count > self._looked:
            text = (
                f"{counted(self._sideways.count, 'scan', 'are')} in a frame whose z axis is not up, as those of "
                f"cameras (optical frames): it is turned by up to {self._tilt:.1f} deg from that of {self._base}"
            )
            return [finding("optical-frame", "defect", text, hint, self._sideways)]
        named = [frame for frame in self._scans if frame.endswith(_OPTICAL)]
        if not named or self._looked:
            return []
        text = f"the frame {named[0]!r} is an optical frame, judging by its name: z is forward, scans lie across it"
        return [Finding("optical-frame", "defect", text, hint, self._scans[named[0]])]

    def _frame_findings(self, frame: str, scans: int, interval_ns: float | None) -> list[Finding]:
        if frame not in self._trees:
            text = f"the scan's frame {frame!r} is not in the transforms"
            return [Finding("frame-unknown", "defect", text, self._cure(frame, ""), scans)]
        found = []
        moving = find_body_motion(self._buffer, frame, self._base)
        if moving is not None:
            text = (
                f"the scan's frame {frame!r} is one that {moving.body} moves in (by {moving.metres:.2f} m): scans are "
                "measured from its origin, and consumers expect them from the robot"
            )
            hint = f"for scans made from clouds: pc2scan convert `target_frame={moving.body}`"
            found.append(Finding("moving-frame", "defect", text, hint, scans))
        apart = [name for name in (self._odom, self._base) if name in self._trees and not self._joined(frame, name)]
        if apart:
            text = f"the scan's frame {frame!r} is not connected with {' or '.join(map(repr, apart))}"
            found.append(Finding("frame-apart", "defect" if self._odom in apart else "notice", text, _HINT, scans))
        missing = self._missing.get(frame)
        if missing is not None:
            share = f"{missing.count:,} of {scans:,} scans"
            text = f"{share} have no transform from {frame!r} to {self._odom!r} at their stamp"
            if few_unplaced(missing.count, scans, interval_ns):
                hint = "a few at the beginning and the end are usual, and SLAM drops them; " + _HINT
                found.append(finding("no-transform", "notice", text, hint, missing))
            else:
                why, hint = self._reasons[frame]
                found.append(finding("no-transform", "defect", f"{text}: {why}", hint or _HINT, missing))
        return found


def mounting_findings(
    topics: Iterable[TopicFacts], buffer: TransformBuffer, frames: Collection[str]
) -> dict[str, Finding]:
    """Look for frames of scans that are tilted, upside down or optical.

    Parameters
    ----------
    topics
        The facts about all topics with clouds.
    frames
        The frames of the scans.

    Returns
    -------
    dict
        A defect for each frame in which the ground of the first clouds is not level.
    """
    findings: dict[str, Finding] = {}
    for facts in topics:
        for frame in dict.fromkeys(frames):
            there = facts.mounting(Placer(frame, buffer=buffer), buffer, moved=True)
            if there is not None and there.fault:
                hint = f"for scans made from clouds: pc2scan convert with {there.options}" if there.options else ""
                what = f"the scan's frame {frame!r} is {there.fault}, by the clouds on {facts.topic}"
                findings.setdefault(frame, Finding("not-level", "defect", what, hint))
    return findings
