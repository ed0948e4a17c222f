"""The table of formats: the content of each, the names of its files, and its writer.

A new format is one entry and one module with a `TopicWriter`.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from pc2scan.errors import UsageError
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    from pathlib import Path

    from .poses import PosesAtStamp


class TopicWriter(Protocol):
    """Writes the messages of one topic."""

    def add(self, item: Any, placed: PosesAtStamp | None) -> None:
        """Write a message.

        Parameters
        ----------
        item
            A `pc2scan.Scan` or a `pc2scan.Cloud`, as the format's entry says.
        placed
            The poses at its stamp; None if no poses are requested.

        Raises
        ------
        MessageError
            If this message cannot be written, but others can.
        UsageError
            If the format cannot store the topic.
        OutputError
            If writing fails, for example because the disk is full.
        """
        ...

    def finish(self) -> list[str]:
        """Complete the files; return warnings about them."""
        ...

    def abort(self) -> None:
        """Close the files."""
        ...


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """A format of export.

    Attributes
    ----------
    name
        The name that users type.
    suffix
        The suffix of its files.
    what
        Their content, as text for users.
    clouds
        Whether it stores clouds; otherwise scans.
    folder
        Whether each topic is a folder of files; otherwise a file.
    needs_poses
        Whether it cannot be written without poses.
    home
        The module and the name of its `TopicWriter`, which takes the path to write, and whether there are poses.
    """

    name: str
    suffix: str
    what: str
    home: tuple[str, str]
    clouds: bool = False
    folder: bool = False
    needs_poses: bool = False

    def open(self, path: Path, *, posed: bool) -> TopicWriter:
        """Begin to write a topic; ``path`` does not exist."""
        module, name = self.home
        writer: TopicWriter = getattr(import_module(f".{module}", __package__), name)(path, posed=posed)
        return writer


#: The formats by name.
FORMATS = {
    entry.name: entry
    for entry in (
        ExportFormat("npz", ".npz", "NumPy arrays: ranges, angles, stamps, poses", ("npz", "NpzWriter")),
        ExportFormat("csv", ".csv", "one row per scan", ("csv_rows", "CsvWriter")),
        ExportFormat("tum", ".tum", "the trajectory only, for evo", ("tum", "TumWriter"), needs_poses=True),
        ExportFormat("carmen", ".log", "CARMEN's ROBOTLASER1", ("carmen", "CarmenWriter"), needs_poses=True),
        ExportFormat("flaser", ".clf", "CARMEN's older FLASER", ("carmen", "FlaserWriter"), needs_poses=True),
        ExportFormat("pcd", ".pcd", "one binary file per cloud", ("pcd", "PcdWriter"), clouds=True, folder=True),
        ExportFormat(
            "kitti",
            ".bin",
            "x, y, z and intensity of each cloud, as KITTI has them",
            ("kitti", "KittiWriter"),
            clouds=True,
            folder=True,
        ),
    )
}


def format_of(name: str | None, destination: Path) -> ExportFormat:
    """Return the format with a name, or if there is none, the format of a file's suffix.

    Raises
    ------
    UsageError
        If there is no such format, or no format has the suffix.
    """
    if name is None:
        suffix = destination.suffix.lower()
        found = next((each for each in FORMATS.values() if each.suffix == suffix and not each.folder), None)
        if found is None:
            hint = f"give `format`: {', '.join(FORMATS)}"
            if folder := next((each for each in FORMATS.values() if each.suffix == suffix and each.folder), None):
                hint = f"a file for each cloud, in a folder: `destination={destination.stem}/`, `format={folder.name}`"
            raise UsageError("no format has this suffix", path=destination, hint=hint)
        return found
    if name not in FORMATS:
        near = did_you_mean(name, FORMATS) or None
        raise UsageError(f"`format` is {name!r}, it must be one of {', '.join(FORMATS)}", hint=near)
    found, suffix = FORMATS[name], destination.suffix.lower()
    others = [each.name for each in FORMATS.values() if each.suffix == suffix and each.suffix != found.suffix]
    if others and not found.folder:
        raise UsageError(f"`format` is {name}, but this is the name of {others[0]}", path=destination)
    return found
