"""Removes content from errors about files that another file names.

A launch file, a scans file or a dataset file may come from somebody else, and can name any file. So errors about these
have the path and the place, but not the content.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError, SeveralNodesError, UsageError
from pc2scan.options.table import PARAMETERS

from .parameters import expected

if TYPE_CHECKING:
    from os import PathLike

_PLACE = r"(?:, |: )((?:line|entry) \d+(?:, column \d+)?)"


def may_quote(err: UsageError, place: str | PathLike[str]) -> bool:
    """Return whether an error has a file, or a place in one, in its text, and may quote what is there."""
    # If the file cannot be read, there is nothing to quote.
    return str(place) in f"{err.where}: {err.message}" and not isinstance(err.__cause__, OSError)


def redact_file(
    err: UsageError, file: str | PathLike[str], named_in: str, option: str = "params_file"
) -> ParameterError:
    """Return an error about a file that another file names, with the line and column, but nothing of the content.

    Parameters
    ----------
    err
        The error, which may quote the file.
    file
        The file, as errors show it.
    named_in
        The place that names it.
    option
        With this option the user can name the file, and then errors may quote it.
    """
    found = re.search(re.escape(str(file)) + _PLACE, f"{err.where}: {err.message}")
    place = f", {found[1]}" if found else ""
    name = _known_name(err)
    what = "several nodes match, `node` chooses one" if isinstance(err, SeveralNodesError) else _fault(err, name)
    return ParameterError(
        f"{file}{place}: {what} (named in {named_in}, so nothing of it is shown)",
        name=name,
        hint=f"`{option}={file}` shows what is wrong",
    )


def _known_name(err: UsageError) -> str:
    """Return the parameter that an error is about; any other name is content."""
    return err.name if isinstance(err, ParameterError) and err.name in PARAMETERS else ""


def _fault(err: UsageError, name: str) -> str:
    """Return what is wrong, without the value."""
    if not name:
        return "not valid"
    return f"{name}: expected {expected(name) if f'{name}: expected ' in err.message else 'another value'}"
