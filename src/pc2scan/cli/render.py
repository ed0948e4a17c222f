"""Prints lines, errors, results and JSON, and shows progress.

All text of the commands is printed here, so that it is safe to show.
"""

from __future__ import annotations

import re
import shlex
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from pc2scan.errors import visible
from pc2scan.options.call import call_words
from pc2scan.options.table import spelling_of
from pc2scan.result import Call
from pc2scan.tables import Table

from .screen import Screen

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator

    from pc2scan.errors import Pc2ScanError
    from pc2scan.result import Part, Result

#: An option in a text, as in Python, in backticks.
_NAMED = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")


def say(text: str = "", *, err: bool = False) -> None:
    """Print one line, with whatever a terminal or a CI system would obey made visible. All commands print with it."""
    typer.echo(visible(text, ascii_only=_ascii_only()), err=err)


def _ascii_only() -> bool:
    """Whether the output file or terminal cannot show every character."""
    encodings = (getattr(stream, "encoding", None) or "ascii" for stream in (sys.stdout, sys.stderr))
    return any(not encoding.lower().startswith("utf") for encoding in encodings)


def show_error(err: Pc2ScanError) -> None:
    """Show an error on standard error: where, what was wrong, and what to do."""
    say(as_typed(f"error: {err}"), err=True)
    if err.hint:
        say(as_typed(f"hint: {err.hint}"), err=True)


def warn(text: str) -> None:
    """Show a warning on standard error."""
    say(as_typed(f"warning: {text}"), err=True)


class LiveWarnings(list[str]):
    """The warnings that were shown while a command ran."""

    def __call__(self, text: str) -> None:
        """Show a warning."""
        self.append(text)
        warn(text)


def as_typed(text: str) -> str:
    """Return a text with its options as they are typed; other text in backticks is unchanged.

    Messages name an option as in Python: ```overwrite=True` replaces it``.

    >>> as_typed("`overwrite=True` replaces it; `topics=/points:=/b` is free; see `min_height` and `ls`")
    '--overwrite replaces it; --topic /points:=/b is free; see --min-height and `ls`'
    """
    return _NAMED.sub(_spelled, text) if "`" in text else text


def _spelled(named: re.Match[str]) -> str:
    name, value = named.groups()
    option = spelling_of(name)
    if option is None:
        return named[0]
    return option if value in (None, "True") else f"{option} {value}"


def print_json(document: object) -> None:
    """Print JSON on standard output."""
    import json

    # Everything else that is not text for a terminal or a CI system is escaped in JSON anyway.
    text = json.dumps(document, indent=2).replace("##", r"\u0023\u0023")
    if isinstance(sys.stdout, Screen):
        sys.stdout.write_as_it_is(f"{text}\n")
        sys.stdout.flush()
    else:
        typer.echo(text)


def show(
    result: Result,
    *,
    as_json: bool = False,
    quiet: bool = False,
    verbose: bool = False,
    known: Container[str] = (),
) -> None:
    """Show a result: what was found or done on standard output, remarks about it on standard error.

    Parameters
    ----------
    as_json
        Whether to print the result as JSON instead.
    quiet
        Whether to print nothing on standard output.
    verbose
        Whether to show everything.
    known
        Warnings that were shown while it was made.
    """
    if as_json:
        print_json(result.as_dict())
    elif not quiet:
        show_parts(result.body(verbose=verbose))
        show_parts(f"note: {note}" for note in result.notes)
    for remark in result.remarks(verbose=verbose):
        if remark.label != "warning" or remark.text not in known:
            say(as_typed(str(remark)), err=True)


def show_parts(parts: Iterable[Part]) -> None:
    """Print parts of a result on standard output, with options as they are typed, and tables fitted to its width.

    Rich is not used, because to import it takes a third of the time in which a small recording is converted.
    """
    for part in parts:
        if isinstance(part, Table):
            shown = part._replace(rows=[[as_typed(cell) for cell in row] for row in part.rows])
            for line in shown.lines(getattr(sys.stdout, "width", None), ascii_only=_ascii_only()):
                say(line)
        elif isinstance(part, Call):
            say(f"  {shlex.join(call_words(part))}")
        else:
            say(as_typed(str(part)))


@contextmanager
def progress_bar(*, enabled: bool) -> Iterator[Callable[[int, int, int], None] | None]:
    """Show bytes, messages, rate and the remaining time; yields the function that updates the bar, or None.

    The function takes the bytes read so far, the total bytes, and the messages read so far.
    """
    if not enabled or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    with Progress(
        BarColumn(),
        DownloadColumn(),
        TextColumn("{task.fields[messages]:,} messages"),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # `Screen` writes warnings above the bar, fitted to the terminal; rich would write them as they are.
        redirect_stdout=False,
        redirect_stderr=False,
    ) as bar:
        task = bar.add_task("convert", total=None, messages=0)

        def update(done: int, total: int, messages: int) -> None:
            bar.update(task, completed=done, total=total, messages=messages)

        yield update
