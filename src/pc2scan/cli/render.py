"""Prints lines, errors, results and JSON, and shows progress.

All text of the commands is printed here, so that it is safe to show. Lines are fitted to a terminal's width; pipes and
files get every line unchanged, even if COLUMNS is set: shells and Python's readline also set it for programs whose
output others read.
"""

from __future__ import annotations

import json
import os
import re
import sys
from contextlib import contextmanager
from shutil import get_terminal_size
from textwrap import wrap
from typing import TYPE_CHECKING, TextIO

from pc2scan.errors import visible
from pc2scan.options.call import call_words
from pc2scan.options.table import spellings
from pc2scan.result import Call, lines_of
from pc2scan.text import shell_word

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator

    from pc2scan.errors import Pc2ScanError
    from pc2scan.options.call import Options
    from pc2scan.result import Part, Remark, Result

#: The smallest width that is used, because no table fits into less.
_NARROWEST = 40

#: How a terminal shows the first word of a line.
_COLOURS = {"error:": "\x1b[1;31m", "warning:": "\x1b[1;33m"}

#: An option in a text, as in Python, in backticks.
_NAMED = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")


class StdoutError(Exception):
    """Standard output cannot be written; ``args[0]`` is the operating system's error."""


def say(text: str = "", *, err: bool = False) -> None:
    """Print one line, with whatever a terminal or a CI system would obey made visible. All commands print with it."""
    stream = sys.stderr if err else sys.stdout
    line = visible(text)
    width = columns_of(stream) or len(line)
    # A command stays one line, to be copied.
    if len(line) > width and not line.lstrip().startswith(("next: ", "pc2scan ")):
        indent = line[: -len(line.lstrip())] + "  "
        line = "\n".join(wrap(line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False))
    label = line.partition(" ")[0]
    # See https://no-color.org.
    if label in _COLOURS and stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb":
        line = f"{_COLOURS[label]}{label}\x1b[0m{line[len(label) :]}"
    _write(f"{line}\n", stream)


def _write(text: str, stream: TextIO) -> None:
    # Characters that the stream's encoding lacks are escaped.
    encoding = stream.encoding or "utf-8"
    try:
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()
    except OSError as err:
        if stream is sys.stdout:
            raise StdoutError(err) from err
        raise


def columns_of(stream: TextIO) -> int | None:
    """Return the columns of a terminal; None for a stream that is none, whose lines have no limit."""
    return max(get_terminal_size().columns, _NARROWEST) if stream.isatty() else None


def show_error(err: Pc2ScanError) -> None:
    """Show an error on standard error: where, what was wrong, and what to do."""
    say(as_typed(f"error: {err}"), err=True)
    if err.hint:
        say(as_typed(f"hint: {err.hint}"), err=True)


class LiveWarnings(list[str]):
    """The warnings that were shown while a command ran."""

    def __call__(self, text: str) -> None:
        """Show a warning on standard error."""
        self.append(text)
        say(as_typed(f"warning: {text}"), err=True)


def as_typed(part: str | Call | Remark) -> str:
    """Return a call as a command line, or a text with its options as they are typed.

    Messages name an option as in Python: ```overwrite=True` replaces it``; other text in backticks is unchanged.

    >>> as_typed("`overwrite=True` replaces it; `topics=/points:=/b` is free; see `min_height` and `ls`")
    '--overwrite replaces it; --topic /points:=/b is free; see --min-height and `ls`'
    """
    if isinstance(part, Call):
        return " ".join(map(shell_word, call_words(part)))
    text = str(part)
    return _NAMED.sub(_spelled, text) if "`" in text else text


def _spelled(named: re.Match[str]) -> str:
    name, value = named.groups()
    option = spellings().get(name)
    if option is None:
        return named[0]
    if value in (None, "True"):
        return option
    plain = re.fullmatch("'([^']*)'", value)
    return f"{option} {shell_word(plain[1]) if plain else value}"


def print_json(document: object) -> None:
    """Print JSON on standard output."""
    # Everything else that is not text for a terminal or a CI system is escaped in JSON anyway.
    _write(json.dumps(document, indent=2).replace("##", r"\u0023\u0023") + "\n", sys.stdout)


def show(result: Result, options: Options, known: Container[str] = ()) -> int:
    """Show a result: what was found or done on standard output, remarks about it on standard error.

    Parameters
    ----------
    options
        The options of the call; ``as_json``, ``quiet`` and ``verbose`` are read.
    known
        Warnings that were shown while it was made.

    Returns
    -------
    int
        Its exit status.
    """
    verbose = bool(options.given.get("verbose"))
    if options.given.get("as_json"):
        print_json(result.as_dict())
    elif not options.given.get("quiet"):
        show_parts(result.body(verbose=verbose))
        show_parts(f"note: {note}" for note in result.notes)
    for remark in result.remarks(verbose=verbose):
        if remark.label != "warning" or remark.text not in known:
            say(as_typed(remark), err=True)
    return result.exit_status


def show_parts(parts: Iterable[Part]) -> None:
    """Print parts of a result on standard output, with options as they are typed, and tables fitted to its width.

    Rich is not used, because to import it takes a third of the time in which a small recording is converted.
    """
    for line in lines_of(parts, columns_of(sys.stdout), as_typed):
        say(line)


@contextmanager
def progress_bar(options: Options, noun: str = "messages") -> Iterator[Callable[..., None] | None]:
    """Show the share done, a number and the time left on a terminal, unless the call is quiet.

    Yields the function that updates the bar, or None. It takes what is done so far, what there is in all, and how many
    of what the noun names are done; also of how many, if that is known.
    """
    if options.given.get("quiet") or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)

        def update(done: int, total: int, *numbers: int) -> None:
            count = " of ".join(f"{number:,}" for number in numbers)
            bar.update(task, completed=done, total=total, description=f"{count} {noun}")

        yield update
