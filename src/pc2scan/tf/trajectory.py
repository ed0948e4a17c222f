"""Trajectories: poses of one frame in another one, read from text files that SLAM and evo write.

TUM's format has lines ``stamp x y z qx qy qz qw``. KITTI's has lines with the first three rows of each pose's matrix,
and no stamps, which are in a second file. Files are untrusted: their size is bounded, and each line is checked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import are_accepted
from pc2scan.errors import UsageError

from .text_files import text_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

#: The largest file: some million poses.
_MAX_BYTES = 500_000_000

#: Numbers of a line in each format.
_TUM, _KITTI = 8, 12

#: Whole numbers from here on are nanoseconds: as seconds they would be after the year 5000.
_NANOSECONDS = 100_000_000_000

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
    parent, child = frames
    text = text_of(path, _MAX_BYTES, "a trajectory", (".tum", ".txt"))
    lines = list(_lines(text))
    if not lines:
        raise UsageError("has no pose", path=path)
    columns = len(lines[0][1])
    if columns not in (_TUM, _KITTI):
        raise UsageError(
            f"line {lines[0][0]}: has {columns} values; a pose has {_TUM} (TUM: stamp x y z qx qy qz qw), or {_KITTI} "
            "(KITTI: the rows of a matrix)",
            path=path,
        )
    if columns == _KITTI:
        return Trajectory(str(path), parent, child, _stamps(path, times, len(lines)), _matrices(path, lines))
    if times is not None:
        raise UsageError("has stamps, so `trajectory_times` has no effect", path=path)
    stamps = np.array([_stamp(words[0], path, number) for number, words in lines], np.int64)
    poses = _numbers(path, [(number, words[1:]) for number, words in lines], _TUM)
    wrong = np.flatnonzero(~are_accepted(poses[:, 3:]))
    if wrong.size:
        number = lines[int(wrong[0])][0]
        shown = " ".join(f"{value:g}" for value in poses[wrong[0], 3:])
        raise UsageError(
            f"line {number}: the quaternion {shown} is not of unit length",
            path=path,
            hint="its order is qx qy qz qw; if that is right, normalise it",
        )
    return Trajectory(str(path), parent, child, stamps, poses)


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the words of each line that has any."""
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if words:
            yield number, words


def _numbers(path: Path, lines: Sequence[tuple[int, list[str]]], columns: int) -> NDArray[np.float64]:
    """Return the numbers of lines with equally many columns; ``columns`` is what errors say, stamps included."""
    expected = len(lines[0][1])
    rows = []
    for number, words in lines:
        if len(words) != expected:
            further = columns - expected
            raise UsageError(
                f"line {number}: has {len(words) + further} values, the first pose has {columns}", path=path
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
        if value.is_finite() and abs(value) < 2**63:
            if abs(value) >= _NANOSECONDS:
                return int(value)
            return int((value * 1_000_000_000).to_integral_value())
    except InvalidOperation:
        pass
    raise UsageError(
        f"line {number}: {word[:80]!r} is not a stamp", path=path, hint="seconds, or nanoseconds, since 1970"
    )


def _stamps(path: Path, times: Path | None, count: int) -> NDArray[np.int64]:
    """Return the stamps of a file in KITTI's format."""
    if times is None:
        raise UsageError(
            "is in KITTI's format, which has no stamps",
            path=path,
            hint="`trajectory_times=times.txt` names a file with the stamp of each pose, one a line",
        )
    lines = list(_lines(text_of(times, _MAX_BYTES, "a list of times", (".txt",))))
    if wrong := next((number for number, words in lines if len(words) != 1), None):
        raise UsageError(f"line {wrong}: has several values; a list of times has one stamp a line", path=times)
    if len(lines) != count:
        raise UsageError(f"has {len(lines):,} stamps, but {path} has {count:,} poses", path=times)
    return np.array([_stamp(words[0], times, number) for number, words in lines], np.int64)


def _matrices(path: Path, lines: Sequence[tuple[int, list[str]]]) -> NDArray[np.float64]:
    """Return poses from the first three rows of their matrices."""
    matrices = _numbers(path, lines, _KITTI).reshape(-1, 3, 4)
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
