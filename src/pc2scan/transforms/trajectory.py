"""Trajectories: poses of one frame in another one, read from text files that SLAM and evo write.

Each line is ``stamp x y z qx qy qz qw``, TUM's format. Files are untrusted: their size is bounded, and each line is
checked.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import are_accepted
from pc2scan.errors import UsageError

from .text_files import open_bounded

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

#: The largest file: some million poses.
_MAX_BYTES = 500_000_000

#: Numbers of a line.
_COLUMNS = 8

#: Whole numbers from here on are nanoseconds: as seconds they would be after the year 5000.
_NANOSECONDS = 100_000_000_000

#: Stamps are before this: sums of them and offsets fit into 64 bits. It is in the year 2116.
_MOST_NS = 1 << 62

#: Characters of a line; a longer one has too many values.
_MAX_LINE = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses of one frame in another one.

    Attributes
    ----------
    name
        The file, or the topic.
    parent, child
        The frames: ``parent_from_child``.
    stamps_ns
        (N,) int64 nanoseconds, in the order of the file.
    poses
        (N, 7) float64: translation x, y, z in metres, rotation x, y, z, w as written.
    """

    name: str
    parent: str
    child: str
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]

    @property
    def first_ns(self) -> int:
        """The earliest stamp."""
        return int(self.stamps_ns.min())

    @property
    def last_ns(self) -> int:
        """The latest stamp."""
        return int(self.stamps_ns.max())

    def moved(self, offset_ns: int) -> Trajectory:
        """Return the same poses at other times: ``offset_ns`` is added to their stamps."""
        return replace(self, stamps_ns=self.stamps_ns + offset_ns) if offset_ns else self


def frames_of_trajectory(text: str) -> tuple[str, str]:
    """Read ``PARENT:CHILD``, the frames of a trajectory.

    Raises
    ------
    UsageError
        If it is something else, or both are the same.
    """
    parent, _, child = text.partition(":")
    if not parent or not child or ":" in child or parent.removeprefix("/") == child.removeprefix("/"):
        raise UsageError(
            f"`trajectory_frames` is {text!r}, it must be two frames",
            hint="write `trajectory_frames=odom:base_link` if the poses are those of base_link in odom; programs that "
            "match clouds usually write those of the lidar: `trajectory_frames=odom:LIDAR`",
        )
    return parent.removeprefix("/"), child.removeprefix("/")


def load_trajectory(path: Path, frames: tuple[str, str]) -> Trajectory:
    """Read a trajectory.

    Parameters
    ----------
    path
        A file in TUM's format. Empty lines, and what follows a ``#``, are ignored.
    frames
        The poses are those of the second frame in the first one.

    Raises
    ------
    UsageError
        If a file cannot be read, or a line is not a pose; the error has the line.
    """
    stamps, numbers, values = array("q"), array("q"), array("d")
    with open_bounded(path, _MAX_BYTES, "a trajectory") as file:
        for number, line in enumerate(iter(partial(file.readline, _MAX_LINE), ""), 1):
            words = line.partition("#")[0].replace(",", " ").split()
            if not words:
                continue
            if len(words) != _COLUMNS:
                message = f"line {number}: has {len(words)} values; a pose has {_COLUMNS}"
                raise UsageError(f"{message} (TUM: stamp x y z qx qy qz qw); evo_traj writes such files", path=path)
            stamps.append(_stamp(words[0], path, number))
            numbers.append(number)
            try:
                values.extend(map(float, words[1:]))
            except ValueError:
                raise UsageError(f"line {number}: {' '.join(words)[:80]!r} are not numbers", path=path) from None
    if not stamps:
        raise UsageError("has no pose", path=path)
    poses = np.array(values).reshape(-1, _COLUMNS - 1)
    if (wrong := np.flatnonzero(~np.isfinite(poses).all(axis=1))).size:
        raise UsageError(f"line {numbers[wrong[0]]}: has a number that is not finite", path=path)
    if (wrong := np.flatnonzero(~are_accepted(poses[:, 3:]))).size:
        shown = " ".join(f"{value:g}" for value in poses[wrong[0], 3:])
        raise UsageError(
            f"line {numbers[wrong[0]]}: the quaternion {shown} is not of unit length",
            path=path,
            hint="its order is qx qy qz qw; if that is right, normalise it",
        )
    return Trajectory(str(path), *frames, np.array(stamps), poses)


def _stamp(word: str, path: Path, number: int) -> int:
    """Return a stamp in nanoseconds: seconds, with all digits that are written, or nanoseconds."""
    try:
        value = Decimal(word)
        if value.is_finite() and abs(value) < _MOST_NS:
            stamp_ns = int(value if abs(value) >= _NANOSECONDS else (value * 1_000_000_000).to_integral_value())
            if abs(stamp_ns) < _MOST_NS:
                return stamp_ns
    except InvalidOperation:
        pass
    raise UsageError(
        f"line {number}: {word[:80]!r} is not a stamp", path=path, hint="seconds, or nanoseconds, since 1970"
    )
