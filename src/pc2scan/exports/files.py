"""Common parts of the formats: text files, folders of clouds, numbers as text, scans with the same beams."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import OutputError, UsageError, stamp_text
from pc2scan.files.new_file import NewFile

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.model import Buffer
    from pc2scan.streams.scans import Scan

#: How many characters are buffered.
_MAX_BUFFERED = 1 << 18


class TextFile:
    """Lines of a new file, in UTF-8.

    Parameters
    ----------
    path
        The file; it must not exist.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = NewFile(path)
        except OSError as err:
            raise OutputError(f"cannot be written: {err.strerror}", path=path) from err
        self._lines: list[str] = []
        self._size = 0

    def line(self, text: str) -> None:
        """Append a line."""
        self._lines.append(text)
        self._size += len(text)
        if self._size > _MAX_BUFFERED:
            self._flush()

    def _flush(self) -> None:
        text = "".join(f"{line}\n" for line in self._lines)
        self._file.put(text.encode("utf-8", "surrogateescape"))
        self._lines.clear()
        self._size = 0

    def finish(self) -> None:
        """Complete the file."""
        self._flush()
        self._file.finish()

    def abort(self) -> None:
        """Release the file."""
        self._file.abort()


class CloudFolder:
    """A new folder.

    Parameters
    ----------
    path
        The folder; it must not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            path.mkdir()
        except OSError as err:
            raise OutputError(f"cannot be made: {err.strerror}", path=path) from err

    def write(self, name: str, *parts: Buffer) -> None:
        """Write a file; staging syncs it to the disk."""
        path = self._path / name
        try:
            with path.open("xb") as file:
                file.writelines(parts)
        except OSError as err:
            raise OutputError(f"cannot be written: {err.strerror}", path=path) from err


def float32_text(value: float) -> str:
    """Return the shortest text that float32 reads back as this value: ``nan``, ``inf``, ``1.5707964``."""
    return str(np.float32(value))


def float32_texts(values: NDArray[np.float32]) -> list[str]:
    """Return `float32_text` of each value."""
    return list(map(str, values))


def planar(rigid: Any) -> Sequence[float]:
    """Return x, y and yaw of a pose: metres and radians."""
    x, y, _ = rigid.translation.tolist()
    return x, y, rigid.rpy[2]


class BeamCheck:
    """Compares each scan with the first one.

    Parameters
    ----------
    what
        What errors call the format's file: ``an .npz archive``.
    angles
        Whether the angles must be the same, too.
    """

    def __init__(self, what: str, *, angles: bool) -> None:
        self._what = what
        self._angles = angles
        self._first: Scan | None = None

    def check(self, scan: Scan) -> None:
        """Raise a `UsageError` if a scan has other beams than the first, or intensities while the first has none."""
        first = self._first
        if first is None:
            self._first = scan
            return
        if len(scan.ranges) != len(first.ranges):
            found = f"{len(scan.ranges)} beams, but the first has {len(first.ranges)}"
        elif self._angles and (scan.angle_min, scan.angle_increment) != (first.angle_min, first.angle_increment):
            found = f"its beams from {scan.angle_min:.6g} rad on, {scan.angle_increment:.6g} rad apart, but the first "
            found += f"from {first.angle_min:.6g} on, {first.angle_increment:.6g} apart"
        elif has_intensities(scan) != has_intensities(first):
            found = (
                "intensities, but the first has none" if has_intensities(scan) else "no intensities, but the first has"
            )
        else:
            return
        raise UsageError(
            f"the scan at {stamp_text(scan.stamp_ns)} has {found}: {self._what} needs scans with the same beams",
            topic=scan.topic,
            hint="`pc2scan convert` with `rebin` gives all scans the same beams; `start` and `end` export a part",
        )


def has_intensities(scan: Scan) -> bool:
    """Whether each beam has an intensity."""
    return len(scan.intensities) == len(scan.ranges) > 0
