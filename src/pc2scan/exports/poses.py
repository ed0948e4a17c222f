"""Poses of the robot at the stamps of messages, from the transforms of a recording.

Poses are interpolated by tf2's rules (see `pc2scan.transforms.buffer`) and never extrapolated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.advice.odometry import odometry_of
from pc2scan.errors import TransformError, UsageError, name_list
from pc2scan.text import did_you_mean
from pc2scan.transforms.frames import BODIES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pc2scan.core.rigid import Rigid
    from pc2scan.streams.objects import Cloud, Scan
    from pc2scan.transforms.reading import RecordedTransforms


class Posed(NamedTuple):
    """The poses of the robot, and of a message's sensor, at the message's stamp.

    Attributes
    ----------
    pose_frame, base_frame, sensor_frame
        The frame of reference of the poses, the robot's frame, and the message's own.
    robot
        The pose of ``base_frame``.
    sensor
        Returns the pose of the message's own frame, or raises a `TransformError` if ``base_frame`` has no transform to
        it.
    """

    pose_frame: str
    base_frame: str
    sensor_frame: str
    robot: Rigid
    sensor: Callable[[], Rigid]


class Poses:
    """The poses of a recording.

    The base frame, if none is given: with poses of a topic and no ``pose_frame``, the frame that these poses move;
    otherwise ``base_link`` or ``base_footprint``, or without these, the message's own.

    Parameters
    ----------
    recorded
        All transforms of the recording.
    pose_frame, base_frame
        As given; empty for none.
    source_frame
        Replaces the frame of messages; empty for their own.

    Raises
    ------
    UsageError
        If a frame does not exist.
    """

    def __init__(self, recorded: RecordedTransforms, pose_frame: str, base_frame: str, source_frame: str) -> None:
        self._transforms = recorded.buffer
        known = sorted(recorded.buffer.frames)
        for option, name in (("pose_frame", pose_frame), ("base_frame", base_frame)):
            if name and name.removeprefix("/") not in known:
                hint = f"{did_you_mean(name, known)} frames: {name_list(known)}; `odom_topic` adds odometry".strip()
                raise UsageError(f"`{option}`: no transforms have the frame {name!r}", hint=hint)
        moved = (each for added in recorded.poses if added.reading for each in added.attachments.values())
        odometry = None if pose_frame else next(moved, None)
        self.pose_frame = pose_frame.removeprefix("/") or (odometry.parent if odometry else "")
        body = next((name for name in BODIES if name in known), "")
        self._base_frame = base_frame.removeprefix("/") or (odometry.frame if odometry else body)
        self._source_frame = source_frame
        self._bases: dict[str, None] = {}

    def at(self, item: Scan | Cloud) -> Posed:
        """Return the poses at the stamp of a message.

        Raises
        ------
        TransformError
            If there is no pose at the stamp, or the stamp is 0.
        """
        frame, stamp_ns = (self._source_frame or item.frame).removeprefix("/"), item.stamp_ns
        if stamp_ns == 0:
            raise TransformError("its stamp is 0, so the robot's pose is unknown")
        base, lookup = self._base_frame or frame, self._transforms.lookup
        self._bases[base] = None
        robot = lookup(self.pose_frame, base, stamp_ns)
        return Posed(self.pose_frame, base, frame, robot, lambda: robot.compose(lookup(base, frame, stamp_ns)))

    def doubts(self) -> Iterator[str]:
        """Yield what may be wrong with the poses that were read."""
        for base in self._bases:
            if doubt := odometry_of(self._transforms, self.pose_frame, base).doubt:
                yield doubt
