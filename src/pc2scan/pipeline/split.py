"""Destinations in several files: reads `split`, and lists the files."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pc2scan.bags.splitting import Cut
from pc2scan.core.quantities import byte_size, duration_ns
from pc2scan.errors import UsageError
from pc2scan.files.places import part_name

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.bags.destinations import Destination


def cut_of(split: str | None, *, repeat_latched: bool) -> Cut | None:
    """Read when a new file begins: ``60s``, ``10min``, ``500MB``, ``1GiB``; None for one file.

    Raises
    ------
    UsageError
        If it is neither a time nor a size, or `repeat_latched` is given without it.
    """
    if split is None:
        if repeat_latched:
            raise UsageError("`repeat_latched` needs `split`", hint="such as `split=60s`")
        return None
    duration, size = duration_ns(split), byte_size(split)
    if not duration and not size:
        raise UsageError(
            f"`split` is {split!r}, it must be a time or a size above 0",
            hint="with its unit: 60s, 10min, 1h, 500MB, 1GiB",
        )
    return Cut(duration_ns=duration or 0, size=size or 0, repeats=repeat_latched)


def expected_files(cut: Cut, target: Destination, last_ns: int, size: float) -> list[str]:
    """Return the names of the expected files; their number is an estimate.

    Parameters
    ----------
    cut
        When a new file begins.
    target
        The destination.
    last_ns
        The last log time, nanoseconds.
    size
        Bytes of the messages before compression.
    """
    count = cut.cell(last_ns) + 1 if cut.duration_ns else max(math.ceil(size / cut.size), 1)
    path = target.path
    if target.format.storages:
        return [str(path / f"{path.name}_{number}{target.file_format.suffix}") for number in range(count)]
    return [str(path.with_name(part_name(path.name, number))) for number in range(count)]


def files_in(unfinished: Path, final: Path) -> list[str]:
    """Return the files that were written, by their final names, in their order.

    Parameters
    ----------
    unfinished
        The directory that they are in.
    final
        The final directory, if it has a metadata.yaml; otherwise the path that the parts are named after.
    """
    names = sorted(entry.name for entry in unfinished.iterdir())
    folder = final if "metadata.yaml" in names else final.parent
    parts = [name for name in names if name != "metadata.yaml"]
    return [str(folder / name) for name in sorted(parts, key=lambda name: (len(name), name))]
