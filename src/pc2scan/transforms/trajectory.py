"""Trajectories: poses of one frame in another one, read from text files that SLAM and evo write.

Each line is ``stamp x y z qx qy qz qw``, TUM's format. Files are untrusted: their size is bounded, and each line is
checked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from pc2scan.core.rigid import are_accepted
from pc2scan.errors import UsageError

from .text_files import open_bounded

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

#: The number of a line, and its words.
Line: TypeAlias = tuple[int, list[str]]

#: The largest file: some million poses.
_MAX_BYTES = 500_000_000

#: Numbers of a line.
_COLUMNS = 8

#: Whole numbers from here on are nanoseconds: as seconds they would be after the year 5000.
_NANOSECONDS = 100_000_000_000

#: Stamps are before this: sums of them and offsets fit into 64 bits. It is in the year 2116.
_MOST_NS = 1 << 62

#: Lines that are read at a time, and characters of one; a longer one has too many values.
_PIECE_LINES = 10_000
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
    stamps: list[NDArray[np.int64]] = []
    poses: list[NDArray[np.float64]] = []
    for lines in _pieces(path):
        stamps.append(np.array([_stamp(words[0], path, number) for number, words in lines], np.int64))
        poses.append(_poses(path, lines))
    if not poses:
        raise UsageError("has no pose", path=path)
    return Trajectory(str(path), *frames, np.concatenate(stamps), np.concatenate(poses))


def _pieces(path: Path) -> Iterator[list[Line]]:
    """Yield the lines of a file that have words, some thousand at a time: they take ten times as much as numbers."""
    with open_bounded(path, _MAX_BYTES, "a trajectory", (".tum", ".txt")) as file:
        numbered = enumerate(iter(partial(file.readline, _MAX_LINE), ""), 1)
        split = ((number, line.partition("#")[0].replace(",", " ").split()) for number, line in numbered)
        lines = (line for line in split if line[1])
        while piece := list(islice(lines, _PIECE_LINES)):
            yield piece


def _poses(path: Path, lines: Sequence[Line]) -> NDArray[np.float64]:
    """Return the poses of lines, as `Trajectory` has them."""
    values = _numbers(path, lines)
    wrong = np.flatnonzero(~are_accepted(values[:, 4:]))
    if wrong.size:
        shown = " ".join(f"{value:g}" for value in values[wrong[0], 4:])
        raise UsageError(
            f"line {lines[int(wrong[0])][0]}: the quaternion {shown} is not of unit length",
            path=path,
            hint="its order is qx qy qz qw; if that is right, normalise it",
        )
    return values[:, 1:]


def _numbers(path: Path, lines: Sequence[Line]) -> NDArray[np.float64]:
    """Return the numbers of lines."""
    rows = []
    for number, words in lines:
        if len(words) != _COLUMNS:
            raise UsageError(
                f"line {number}: has {len(words)} values; a pose has {_COLUMNS} (TUM: stamp x y z qx qy qz qw)",
                path=path,
                hint="KITTI's format has 12, and no stamps: evo_traj makes a TUM file of it"
                if len(words) == 12
                else None,
            )
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise UsageError(f"line {number}: {' '.join(words)[:80]!r} are not numbers", path=path) from None
    values = np.array(rows, np.float64)
    wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if wrong.size:
        raise UsageError(f"line {lines[int(wrong[0])][0]}: has a number that is not finite", path=path)
    return values


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
