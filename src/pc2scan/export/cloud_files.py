"""A folder with a file for each cloud."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import OutputError

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.model import Buffer


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
