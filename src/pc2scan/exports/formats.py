"""The table of formats: the names of their files, what they store, and the function that writes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import UsageError

from .clouds import write_kitti, write_pcd
from .scans import write_csv, write_npz, write_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from pathlib import Path

    from .scans import Write


class ExportFormat(NamedTuple):
    """A format of export.

    Attributes
    ----------
    name
        The name that users type.
    suffix
        The suffix of its files.
    open
        Begins to write a topic at a path that does not exist. The function that it yields raises a `MessageError` if a
        message cannot be written, but others can, and a `UsageError` if the format cannot store the topic.
    needs_poses
        Whether it cannot be written without poses.
    clouds
        Whether it stores clouds, each in a file of a folder; otherwise scans, in one file.
    """

    name: str
    suffix: str
    open: Callable[[Path], AbstractContextManager[Write]]
    needs_poses: bool = False
    clouds: bool = False


#: The formats by name.
FORMATS = {
    "npz": ExportFormat("npz", ".npz", write_npz),
    "csv": ExportFormat("csv", ".csv", write_csv),
    "tum": ExportFormat("tum", ".tum", write_tum, needs_poses=True),
    "pcd": ExportFormat("pcd", ".pcd", write_pcd, clouds=True),
    "kitti": ExportFormat("kitti", ".bin", write_kitti, clouds=True),
}


def format_of(name: str | None, destination: Path) -> ExportFormat:
    """Return the format with a name, or if there is none, the format of a file's suffix.

    Raises
    ------
    UsageError
        If no format has the suffix, or another one than that with the name.
    """
    by_suffix = next((each for each in FORMATS.values() if each.suffix == destination.suffix.lower()), None)
    if name is not None:
        if by_suffix is not None and by_suffix.name != name and not FORMATS[name].clouds:
            raise UsageError(f"`format` is {name}, but this is the name of {by_suffix.name}", path=destination)
        return FORMATS[name]
    if by_suffix is None or by_suffix.clouds:
        hint = f"give `format`: {', '.join(FORMATS)}; clouds are files in a folder"
        raise UsageError("no format has this suffix", path=destination, hint=hint)
    return by_suffix
