"""NumPy's .npz: one archive with the arrays of a topic.

An array's length is at its beginning, but the number of scans is known only at the end. So each array is collected in a
file without a name, and copied into the archive at the end, which needs little memory for any recording. The archive is
not compressed, and its bytes depend on the scans alone.
"""

from __future__ import annotations

import tempfile
import zipfile
from contextlib import contextmanager, suppress
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import OutputError

from .files import BeamCheck, has_intensities, planar

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import ArrayLike

    from pc2scan.streams.scans import Scan

    from .poses import PosesAtStamp

#: How many bytes are copied at a time.
_PIECE = 1 << 20

#: The numbers of a scan that become arrays, by the name of the array.
_NUMBERS = {"range_min": "<f4", "range_max": "<f4", "time_increment": "<f4", "scan_time": "<f4"}


class NpzWriter:
    """An archive: ``ranges`` (scans, beams), ``angles`` (beams,), ``stamps`` (scans,), ``poses`` (scans, 3), ..."""

    def __init__(self, path: Path, *, posed: bool) -> None:
        self._path = path
        self._posed = posed
        self._beams = BeamCheck("an .npz archive", angles=True)
        self._first: Scan | None = None
        self._placed: PosesAtStamp | None = None
        self._arrays: dict[str, _GrowingArray] = {}

    def add(self, item: Scan, placed: PosesAtStamp | None) -> None:
        """Append a scan to the arrays."""
        self._beams.check(item)
        if self._first is None:
            self._first, self._placed = item, placed
            with self._writing():
                self._arrays = self._empty(len(item.ranges), intensities=has_intensities(item))
        arrays = self._arrays
        with self._writing():
            arrays["ranges"].append(item.ranges)
            if "intensities" in arrays:
                arrays["intensities"].append(item.intensities)
            arrays["stamps"].append(item.stamp_ns)
            arrays["log_times"].append(item.log_time_ns)
            if placed is not None:
                arrays["poses"].append(planar(placed.robot))
            for name in _NUMBERS:
                arrays[name].append(getattr(item, name))

    def _empty(self, beams: int, *, intensities: bool) -> dict[str, _GrowingArray]:
        shapes: dict[str, tuple[str, tuple[int, ...]]] = {"ranges": ("<f4", (beams,))}
        if intensities:
            shapes["intensities"] = ("<f4", (beams,))
        shapes |= {"stamps": ("<i8", ()), "log_times": ("<i8", ())}
        if self._posed:
            shapes["poses"] = ("<f8", (3,))
        shapes |= {name: (dtype, ()) for name, dtype in _NUMBERS.items()}
        return {name: _GrowingArray(self._path.parent, *shape) for name, shape in shapes.items()}

    def finish(self) -> list[str]:
        """Write the archive."""
        first = self._first
        assert first is not None
        alone: dict[str, ArrayLike] = {"angles": first.angles, "topic": first.topic, "frame": first.frame}
        if self._placed is not None:
            alone |= {"pose_frame": self._placed.pose_frame, "base_frame": self._placed.base_frame}
        with self._writing(), zipfile.ZipFile(self._path, "x", zipfile.ZIP_STORED) as archive:
            for name, array in self._arrays.items():
                with _member(archive, name) as file:
                    array.copy_to(file)
                array.close()
            for name, value in alone.items():
                with _member(archive, name) as file:
                    np.lib.format.write_array(file, np.asanyarray(value), allow_pickle=False)
        return []

    def abort(self) -> None:
        """Release the files without a name."""
        for array in self._arrays.values():
            # Closing writes buffered data, which fails again if the disk is full; the data are not needed.
            with suppress(OSError):
                array.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as err:
            raise OutputError(f"cannot be written: {err.strerror}", path=self._path) from err


def _member(archive: zipfile.ZipFile, name: str) -> IO[bytes]:
    # The earliest time of the format, so that the same scans give the same bytes.
    return archive.open(zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0)), "w", force_zip64=True)


class _GrowingArray:
    """Rows of one shape, in a file without a name, which is deleted when it is closed."""

    def __init__(self, folder: Path, dtype: str, shape: tuple[int, ...]) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed by its owner
        self._dtype = np.dtype(dtype)
        self._shape = shape
        self._rows = 0

    def append(self, row: Any) -> None:
        self._file.write(np.ascontiguousarray(row, self._dtype).tobytes())
        self._rows += 1

    def copy_to(self, file: IO[bytes]) -> None:
        """Write the array as an .npy file."""
        header = {"descr": self._dtype.str, "fortran_order": False, "shape": (self._rows, *self._shape)}
        np.lib.format.write_array_header_1_0(file, header)
        self._file.seek(0)
        while piece := self._file.read(_PIECE):
            file.write(piece)

    def close(self) -> None:
        self._file.close()
