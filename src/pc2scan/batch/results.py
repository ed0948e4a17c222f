"""Names of results that are several files: ``drive_scan_0.bag`` stands for all parts of ``drive_scan.bag``.

A result that is one file is named ``drive_scan.bag``, so that the two kinds cannot be confused.
"""

from __future__ import annotations

import re

from pc2scan.bags.formats import file_suffixes
from pc2scan.files.places import part_name


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
