"""Trajectories: poses of one frame in another one, read from text files that SLAM and evo write.

TUM's format has lines ``stamp x y z qx qy qz qw``. KITTI's has lines with the first three rows of each pose's matrix,
and no stamps, which are in a second file. Files are untrusted: their size is bounded, and each line is checked.
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

#: Numbers of a line in each format.
_TUM, _KITTI = 8, 12

#: Whole numbers from here on are nanoseconds: as seconds they would be after the year 5000.
_NANOSECONDS = 100_000_000_000

#: Stamps are before this: sums of them and offsets fit into 64 bits. It is in the year 2116.
_MOST_NS = 1 << 62

#: Lines that are read at a time, and characters of one; a longer one has too many values.
_PIECE_LINES = 10_000
_MAX_LINE = 1 << 16

#: How far the rows of a rotation matrix may be from orthonormal.
_ORTHONORMAL = 0.01


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


def load_trajectory(path: Path, frames: tuple[str, str], times: Path | None = None) -> Trajectory:
    """Read a trajectory.

    Parameters
    ----------
    path
        A file in TUM's format, or with ``times`` in KITTI's. Empty lines, and what follows a ``#``, are ignored.
    frames
        The poses are those of the second frame in the first one.
    times
        The stamps of the poses of a file in KITTI's format: one number a line, seconds or nanoseconds.

    Raises
    ------
    UsageError
        If a file cannot be read, or a line is not a pose; the error has the line.
    """
    stamps: list[NDArray[np.int64]] = []
    poses: list[NDArray[np.float64]] = []
    columns = 0
    for lines in _pieces(path, "a trajectory", (".tum", ".txt")):
        columns = columns or _columns(path, *lines[0])
        if columns == _TUM:
            stamps.append(_stamps(path, lines))
        poses.append(_poses(path, lines, columns))
    if not poses:
        raise UsageError("has no pose", path=path)
    joined = np.concatenate(poses)
    if columns == _KITTI:
        stamps = [_times(path, times, len(joined))]
    elif times is not None:
        raise UsageError("has stamps, so `trajectory_times` has no effect", path=path)
    return Trajectory(str(path), *frames, np.concatenate(stamps), joined)


def _pieces(path: Path, what: str, suffixes: tuple[str, ...]) -> Iterator[list[Line]]:
    """Yield the lines of a file that have words, some thousand at a time: they take ten times as much as numbers."""
    with open_bounded(path, _MAX_BYTES, what, suffixes) as file:
        numbered = enumerate(iter(partial(file.readline, _MAX_LINE), ""), 1)
        split = ((number, line.partition("#")[0].replace(",", " ").split()) for number, line in numbered)
        lines = (line for line in split if line[1])
        while piece := list(islice(lines, _PIECE_LINES)):
            yield piece


def _columns(path: Path, number: int, words: list[str]) -> int:
    """Return how many values the first line has."""
    if len(words) not in (_TUM, _KITTI):
        raise UsageError(
            f"line {number}: has {len(words)} values; a pose has {_TUM} (TUM: stamp x y z qx qy qz qw), or {_KITTI} "
            "(KITTI: the rows of a matrix)",
            path=path,
        )
    return len(words)


def _poses(path: Path, lines: Sequence[Line], columns: int) -> NDArray[np.float64]:
    """Return the poses of lines, as `Trajectory` has them."""
    values = _numbers(path, lines, columns)
    if columns == _KITTI:
        return _of_matrices(path, lines, values)
    wrong = np.flatnonzero(~are_accepted(values[:, 4:]))
    if wrong.size:
        shown = " ".join(f"{value:g}" for value in values[wrong[0], 4:])
        raise UsageError(
            f"line {lines[int(wrong[0])][0]}: the quaternion {shown} is not of unit length",
            path=path,
            hint="its order is qx qy qz qw; if that is right, normalise it",
        )
    return values[:, 1:]


def _numbers(path: Path, lines: Sequence[Line], columns: int) -> NDArray[np.float64]:
    """Return the numbers of lines, which have as many columns as the first one."""
    rows = []
    for number, words in lines:
        if len(words) != columns:
            raise UsageError(f"line {number}: has {len(words)} values, the first pose has {columns}", path=path)
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise UsageError(f"line {number}: {' '.join(words)[:80]!r} are not numbers", path=path) from None
    values = np.array(rows, np.float64)
    wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if wrong.size:
        raise UsageError(f"line {lines[int(wrong[0])][0]}: has a number that is not finite", path=path)
    return values


def _stamps(path: Path, lines: Sequence[Line]) -> NDArray[np.int64]:
    """Return the stamps that lines begin with, nanoseconds."""
    return np.array([_stamp(words[0], path, number) for number, words in lines], np.int64)


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


def _times(path: Path, times: Path | None, count: int) -> NDArray[np.int64]:
    """Return the stamps of a file in KITTI's format."""
    if times is None:
        raise UsageError(
            "is in KITTI's format, which has no stamps",
            path=path,
            hint="`trajectory_times=times.txt` names a file with the stamp of each pose, one a line",
        )
    stamps = [np.empty(0, np.int64)]
    for lines in _pieces(times, "a list of times", (".txt",)):
        if wrong := next((number for number, words in lines if len(words) != 1), None):
            raise UsageError(f"line {wrong}: has several values; a list of times has one stamp a line", path=times)
        stamps.append(_stamps(times, lines))
    joined = np.concatenate(stamps)
    if len(joined) != count:
        raise UsageError(f"has {len(joined):,} stamps, but {path} has {count:,} poses", path=times)
    return joined


def _of_matrices(path: Path, lines: Sequence[Line], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses from the first three rows of their matrices."""
    matrices = values.reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    products = np.einsum("nij,nkj->nik", rotations, rotations)
    off = np.abs(products - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero(~((off < _ORTHONORMAL) & (np.linalg.det(rotations) > 0)))
    if wrong.size:
        raise UsageError(
            f"line {lines[int(wrong[0])][0]}: its rotation is not one: the rows of the matrix are not orthonormal",
            path=path,
            hint="a line has r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz",
        )
    return np.concatenate([matrices[:, :, 3], _quaternions(rotations)], axis=1)


def _quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternions (N, 4) x, y, z, w of rotation matrices (N, 3, 3).

    Source of the rule: Shepperd's method: the largest of the four squared components is computed first.
    """
    m = rotations
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    squares = np.stack([xx - yy - zz, yy - xx - zz, zz - xx - yy, xx + yy + zz], axis=1) + 1.0
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    rows = np.stack(
        [
            np.stack([squares[:, 0], xy, xz, wx], axis=1),
            np.stack([xy, squares[:, 1], yz, wy], axis=1),
            np.stack([xz, yz, squares[:, 2], wz], axis=1),
            np.stack([wx, wy, wz, squares[:, 3]], axis=1),
        ],
        axis=1,
    )
    chosen = rows[np.arange(len(m)), squares.argmax(axis=1)]
    return np.asarray(chosen / np.linalg.norm(chosen, axis=1, keepdims=True))
