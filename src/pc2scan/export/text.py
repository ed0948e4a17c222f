"""Writes a text file line by line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import OutputError
from pc2scan.files.source import NewFile

if TYPE_CHECKING:
    from pathlib import Path

#: How many characters are buffered.
_MOST = 1 << 18


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
        if self._size > _MOST:
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
