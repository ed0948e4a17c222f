"""Removes content from errors about files that another file names.

A launch file, a scans file or a dataset file may come from somebody else, and can name any file. So errors about these
have the path and the place, but not the content.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError, UsageError
from pc2scan.options.table import PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable
    from os import PathLike


@contextmanager
def not_quoting(files: Iterable[tuple[str | PathLike[str], str, str]]) -> Generator[None]:
    """Replace errors about files by such with the line and column, but nothing of the content.

    Parameters
    ----------
    files
        The files, as errors show them; the place that names each; and the option with which the user can name it, and
        then errors may quote it.
    """
    try:
        yield
    except UsageError as err:
        said = f"{err.where}: {err.message}"
        for file, named_in, option in files:
            # If the file cannot be read, there is nothing to quote.
            if str(file) in said and not isinstance(err.__cause__, OSError):
                position = re.search(re.escape(str(file)) + r"(?:, |: )((?:line|entry) \d+(?:, column \d+)?)", said)
                # Any other name is content.
                name = err.name if isinstance(err, ParameterError) and err.name in PARAMETERS else ""
                what = f"{name}: expected another value" if name else "not valid"
                message = f"{file}{f', {position[1]}' if position else ''}: {what} (named in {named_in}"
                hint = f"`{option}={file}` shows what is wrong"
                raise ParameterError(f"{message}, so nothing of it is shown)", name=name, hint=hint) from None
        raise
