"""Names of recordings in several numbered files: ``drive.bag`` becomes ``drive_0.bag``, ``drive_1.bag`` and so on."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


def part_name(name: str, number: int) -> str:
    """Return the name of a part of a recording: ``drive.bag`` becomes ``drive_0.bag``."""
    stem, dot, suffix = name.rpartition(".")
    return f"{stem}_{number}.{suffix}" if dot else f"{name}_{number}"


def part_number(name: str) -> int:
    """Return the number of a part.

    >>> part_number("drive_1_20.bag")
    20
    """
    return int(re.findall(r"_(\d+)", name)[-1])


def parts_among(names: Iterable[str], name: str) -> list[str]:
    """Return those names that are names of parts of a recording, by their numbers.

    >>> parts_among(["drive_10.bag", "drive_2.bag", "drive_02.bag", "drive_x.bag", "drive.bag"], "drive.bag")
    ['drive_2.bag', 'drive_10.bag']
    """
    stem, dot, suffix = name.rpartition(".")
    stem, suffix = (stem, f".{suffix}") if dot else (name, "")
    pattern = rf"{re.escape(stem)}_(?:0|[1-9]\d*){re.escape(suffix)}"
    return sorted(filter(re.compile(pattern).fullmatch, names), key=part_number)


def parts_beside(dst: Path) -> list[Path]:
    """Return what exists beside a destination with the name of a part of it: ``drive_0.bag`` of ``drive.bag``."""
    try:
        return [dst.with_name(name) for name in parts_among((entry.name for entry in dst.parent.iterdir()), dst.name)]
    except OSError:
        return []
