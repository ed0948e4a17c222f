"""Names of results that are several files: ``drive_scan_0.bag`` stands for all parts of ``drive_scan.bag``.

A result that is one file is named ``drive_scan.bag``, so that the two kinds cannot be confused.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags.formats import file_suffixes
from pc2scan.bags.splitting import part_name
from pc2scan.files.staged_parts import parts_beside

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["files_of", "first_part", "in_order", "is_numbered", "parts_among", "whole"]


def first_part(output: str) -> str:
    """Return the name of the first part of a result.

    >>> first_part("robot1/drive_scan.bag")
    'robot1/drive_scan_0.bag'
    """
    folder, slash, name = output.rpartition("/")
    return f"{folder}{slash}{part_name(name, 0)}"


def is_numbered(output: str) -> bool:
    """Return whether this is the first file of a result with numbered files."""
    return _numbered(output) is not None


def _numbered(output: str) -> re.Match[str] | None:
    """Return the name without the number, and the suffix, of the first file of a result with numbered files."""
    suffixes = "|".join(map(re.escape, file_suffixes()))
    return re.fullmatch(rf"(.*_scan)_0({suffixes})", output, re.DOTALL)


def whole(output: str) -> str:
    """Return the name of a result without the number; a name without a number is returned as it is.

    >>> whole("drive_scan_0.bag"), whole("drive_scan.bag")
    ('drive_scan.bag', 'drive_scan.bag')
    """
    found = _numbered(output)
    return output if found is None else f"{found[1]}{found[2]}"


def files_of(folder: Path, output: str) -> list[Path]:
    """Return the existing files of a result, in their order; for a result that is not numbered, its path."""
    path = folder / whole(output)
    if not is_numbered(output):
        return [path]
    # By number: in alphabetical order, 10 would come before 2.
    return [path.with_name(name) for name in in_order(part.name for part in parts_beside(path))]


def parts_among(names: Iterable[str], output: str) -> list[str]:
    """Return those of the names in a folder that are files of a numbered result, in their order."""
    path = Path(whole(output))
    named = re.compile(rf"{re.escape(path.with_suffix('').as_posix())}_\d+{re.escape(path.suffix)}")
    return in_order(name for name in names if named.fullmatch(name))


def in_order(names: Iterable[str]) -> list[str]:
    """Return the names of parts of one result in the order of their numbers."""
    return sorted(names, key=lambda name: (len(name), name))
