"""The formats of scans: a function each, which writes the scans of a topic.

Each yields a function that writes one scan, and completes the file when its block ends.
"""

from __future__ import annotations

import shutil
import zipfile
from contextlib import ExitStack, contextmanager
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import UnwritableError, UsageError, stamp_text
from pc2scan.tables import csv_cell

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path
    from typing import TypeAlias

    from numpy.typing import ArrayLike, NDArray

    from pc2scan.core.rigid import Rigid
    from pc2scan.streams.scans import Scan

    from .poses import Posed

    #: Writes a message, a `pc2scan.Scan` or a `pc2scan.Cloud`, with the poses at its stamp; None without poses.
    Write: TypeAlias = Callable[[Any, Posed | None], None]

#: Numbers of a scan that are float32 in the message.
_GEOMETRY = ("angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")


def lines_file(path: Path) -> IO[str]:
    """Create a text file."""
    return path.open("x", encoding="utf-8", errors="surrogateescape", newline="\n")


def _texts(values: ArrayLike) -> list[str]:
    """Return the shortest texts that float32 reads back as these values: ``nan``, ``inf``, ``1.5707964``."""
    return list(map(str, np.atleast_1d(np.asarray(values, np.float32))))


def _planar(rigid: Rigid) -> Sequence[float]:
    """Return x, y and yaw of a pose: metres and radians."""
    x, y, _ = rigid.translation.tolist()
    return x, y, rigid.rpy[2]


def _has_intensities(scan: Scan) -> bool:
    return len(scan.intensities) == len(scan.ranges) > 0


def _refuse_other_beams(scan: Scan, first: Scan, what: str, *, angles: bool) -> None:
    """Raise if a scan has other beams than the first, or if only one of the two has intensities."""
    layouts = []
    for each in (scan, first):
        text = f"{len(each.ranges)} beams {'with' if _has_intensities(each) else 'without'} intensities"
        angle = f" from {each.angle_min:.9g} rad on, {each.angle_increment:.9g} rad apart" if angles else ""
        layouts.append(text + angle)
    if layouts[0] != layouts[1]:
        stamp = stamp_text(scan.stamp_ns)
        text = f"{what} needs scans with the same beams, but the scan at {stamp} has {layouts[0]}, and the first"
        hint = "`pc2scan convert` with `rebin` gives all scans the same beams; `start` and `end` export a part"
        raise UsageError(f"{text} {layouts[1]}", topic=scan.topic, hint=hint)


@contextmanager
def write_csv(path: Path) -> Iterator[Write]:
    """Write a row for each scan: stamps, pose, geometry, ``range_0`` and so on, ``intensity_0`` and so on.

    Numbers have the fewest digits from which float32 (for poses float64) reads the recorded value.
    """
    first: Scan | None = None
    with lines_file(path) as file:

        def write(scan: Scan, posed: Posed | None) -> None:
            nonlocal first
            if first is None:
                first = scan
                beams = range(len(scan.ranges))
                names = ["stamp_ns", "log_time_ns", "frame", *(("x", "y", "yaw") if posed else ()), *_GEOMETRY]
                names += [f"range_{i}" for i in beams] + [f"intensity_{i}" for i in beams if _has_intensities(scan)]
                file.write(",".join(names) + "\n")
            _refuse_other_beams(scan, first, "a CSV file", angles=False)
            row = [str(scan.stamp_ns), str(scan.log_time_ns), csv_cell(scan.frame)]
            row += map(repr, _planar(posed.robot) if posed else ())
            row += _texts([getattr(scan, name) for name in _GEOMETRY]) + _texts(scan.ranges)
            row += _texts(scan.intensities) if _has_intensities(scan) else ()
            file.write(",".join(row) + "\n")

        yield write


@contextmanager
def write_npz(path: Path) -> Iterator[Write]:
    """Write an archive: ``ranges`` (scans, beams), ``angles`` (beams,), ``stamps`` (scans,), ``poses`` (scans, 3), ...

    The number of scans, which is at the beginning of each array, is known only at the end. So each array is collected
    in a temporary file. The archive is not compressed, and its bytes depend on the scans alone.
    """
    count = 0
    first: Scan | None = None
    row: dict[str, NDArray[Any]] = {}
    alone: dict[str, ArrayLike] = {}
    files: dict[str, IO[bytes]] = {}
    with ExitStack() as stack:

        def write(scan: Scan, posed: Posed | None) -> None:
            nonlocal count, first, row
            row = {"ranges": np.asarray(scan.ranges, "<f4")}
            if _has_intensities(scan):
                row["intensities"] = np.asarray(scan.intensities, "<f4")
            row |= {"stamps": np.asarray(scan.stamp_ns, "<i8"), "log_times": np.asarray(scan.log_time_ns, "<i8")}
            if posed:
                row["poses"] = np.asarray(_planar(posed.robot), "<f8")
            for name in ("range_min", "range_max", "time_increment", "scan_time"):
                row[name] = np.asarray(getattr(scan, name), "<f4")
            if first is None:
                first = scan
                alone.update(angles=scan.angles, topic=scan.topic, frame=scan.frame)
                if posed:
                    alone.update(pose_frame=posed.pose_frame, base_frame=posed.base_frame)
                files.update({name: stack.enter_context(TemporaryFile(dir=path.parent)) for name in row})
            _refuse_other_beams(scan, first, "an .npz archive", angles=True)
            for name, values in row.items():
                files[name].write(values.tobytes())
            count += 1

        yield write
        with zipfile.ZipFile(path, "x") as archive:
            for name, values in (row | alone).items():
                # The earliest time of the format, so that the same scans give the same bytes.
                info = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
                with archive.open(info, "w", force_zip64=True) as member:
                    if name in alone:
                        np.lib.format.write_array(member, np.asarray(values), allow_pickle=False)
                        continue
                    shape = (count, *row[name].shape)
                    header = {"descr": row[name].dtype.str, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(member, header)
                    files[name].seek(0)
                    shutil.copyfileobj(files[name], member)


@contextmanager
def write_tum(path: Path) -> Iterator[Write]:
    """Write a line for each scan, as evo reads it: ``timestamp x y z qx qy qz qw``, seconds and metres."""
    last_ns: int | None = None
    with lines_file(path) as file:

        def write(scan: Scan, posed: Posed | None) -> None:
            nonlocal last_ns
            assert posed is not None
            if last_ns is not None and scan.stamp_ns <= last_ns:
                raise UnwritableError(f"its stamp is not later than the one before, {stamp_text(last_ns)}")
            last_ns = scan.stamp_ns
            file.write(" ".join((stamp_text(scan.stamp_ns), *map(repr, posed.robot.pose))) + "\n")

        yield write
