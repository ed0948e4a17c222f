"""Prints lines, errors, results and JSON, shows progress, and fits all to the terminal.

All text of the commands is printed here, so that it is safe to show. On a terminal, lines are wrapped at its width, and
coloured if it shows colours, as they are written, so that no command has to deal with it. Pipes and files get every
line unchanged (except of `limit_width`), even if COLUMNS is set: shells and Python's readline also set it for programs
whose output others read.
"""

from __future__ import annotations

import json
import os
import re
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

import typer

from pc2scan.errors import visible
from pc2scan.options.call import call_words
from pc2scan.options.table import spelling_of
from pc2scan.result import Call
from pc2scan.tables import Table
from pc2scan.text import shell_word

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator

    from pc2scan.errors import Pc2ScanError
    from pc2scan.result import Part, Result

#: The width of lines in pipes and files, where a command limits it.
_IN_PIPES = 120

#: The smallest width that is used, because no table fits into less.
_NARROWEST = 40

_RED, _YELLOW, _GREEN, _BOLD, _PLAIN = "\x1b[31m", "\x1b[33m", "\x1b[32m", "\x1b[1m", "\x1b[0m"

#: Moves the cursor to the beginning of the line, and erases the line.
_ERASED = "\r\x1b[2K"

#: Patterns of the beginnings of lines, and their colours. They are compiled at their first use, because most output is
#: not coloured.
_COLOURS = (
    (r"\s*(?:error|defect|aborts|different|not ok|failed|FAILED)\b:?", _BOLD + _RED),
    (r"\s*(?:warning|notice|skipped|damaged|misplaced|ignored|empty):", _BOLD + _YELLOW),
    (r"(?:ok|same|passed)\b:?", _BOLD + _GREEN),
    (r"(?:hint|next|note|recovered):", _BOLD),
)

#: An option in a text, as in Python, in backticks.
_NAMED = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")


def say(text: str = "", *, err: bool = False) -> None:
    """Print one line, with whatever a terminal or a CI system would obey made visible. All commands print with it."""
    typer.echo(visible(text, ascii_only=_ascii_only()), err=err)


def _ascii_only() -> bool:
    """Whether the output file or terminal cannot show every character."""
    encodings = (getattr(stream, "encoding", None) or "ascii" for stream in (sys.stdout, sys.stderr))
    return any(not encoding.lower().startswith("utf") for encoding in encodings)


def limit_width() -> None:
    """Fit lines in pipes and files, too: of results whose lines would be as long as a user's folders and names."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, Screen) and stream.width is None:
            stream.width = _IN_PIPES


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
    if value in (None, "True"):
        return option
    plain = re.fullmatch("'([^']*)'", value)
    return f"{option} {shell_word(plain[1]) if plain else value}"


def print_json(document: object) -> None:
    """Print JSON on standard output."""
    # Everything else that is not text for a terminal or a CI system is escaped in JSON anyway.
    text = json.dumps(document, indent=2).replace("##", r"\u0023\u0023")
    getattr(sys.stdout, "write_as_it_is", sys.stdout.write)(f"{text}\n")
    sys.stdout.flush()


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
            words = map(shell_word, call_words(part))
            say(f"  {' '.join(words)}")
        else:
            say(as_typed(str(part)))


@contextmanager
def progress_bar(
    text: str = "{task.fields[messages]:,} messages", *names: str, enabled: bool
) -> Iterator[Callable[..., None] | None]:
    """Show the share done, a text and the time left on a terminal; yields the function that updates the bar, or None.

    The function takes what is done so far, what there is in all, and the numbers in the text, by default the messages.
    """
    if not enabled or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    names = names or ("messages",)
    with Progress(
        BarColumn(),
        TaskProgressColumn(),
        TextColumn(text),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # `Screen` writes lines above the bar, fitted to the terminal; rich would write them as they are.
        redirect_stdout=False,
        redirect_stderr=False,
    ) as bar:
        fields: dict[str, Any] = dict.fromkeys(names, 0)
        task = bar.add_task("", total=None, **fields)

        def update(done: int, total: int, *numbers: int) -> None:
            fields.update(zip(names, numbers, strict=True))
            bar.update(task, completed=done, total=total, **fields)

        yield update


class StdoutError(Exception):
    """Standard output cannot be written; ``args[0]`` is the operating system's error."""


def width_of(stream: Any) -> int | None:
    """Return the maximum width of lines on a stream in columns; None for no limit."""
    try:
        if not stream.isatty():
            return None
        width = os.environ.get("COLUMNS", "")
        columns = int(width) if width.isdecimal() else os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):
        return None
    return max(columns or 80, _NARROWEST)


def _has_colours(stream: Any) -> bool:
    """Whether a stream shows colours. See https://no-color.org and https://force-color.org."""
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    return bool(stream.isatty()) and os.environ.get("TERM", "") not in {"", "dumb"}


class Screen:
    """A text stream that fits lines to the terminal.

    Parameters
    ----------
    stream
        The stream to write to.
    guarded
        Whether errors are raised as `StdoutError`, to distinguish them from those of other files.

    Attributes
    ----------
    width
        The maximum width of lines in columns; None for no limit.
    """

    def __init__(self, stream: TextIO, *, guarded: bool = False) -> None:
        self._stream = stream
        self._guarded = guarded
        self.width = width_of(stream)
        self._colours = _has_colours(stream)
        # Whether the cursor is at the end of a progress bar.
        self._at_bar = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text with its lines fitted. Text that moves the cursor (a progress bar) is written unchanged.

        Lines that follow a progress bar replace it, because it is drawn again below them.
        """
        if "\x1b" in text or "\r" in text:
            self._at_bar = not text.endswith("\n")
        elif text.endswith("\n"):
            if self.width or self._colours:
                text = "".join(f"{self._shown(line)}\n" for line in text[:-1].split("\n"))
            if self._at_bar:
                text, self._at_bar = f"{_ERASED}{text}", False
        return self.write_as_it_is(text)

    def write_as_it_is(self, text: str) -> int:
        """Write text for programs, such as JSON, unchanged."""
        with self._guard():
            return self._stream.write(text)

    def flush(self) -> None:
        """Flush."""
        with self._guard():
            self._stream.flush()

    @contextmanager
    def _guard(self) -> Iterator[None]:
        try:
            yield
        except OSError as err:
            if self._guarded:
                raise StdoutError(err) from err
            raise

    def _shown(self, line: str) -> str:
        if self.width and len(line) > self.width:
            line = _wrapped(line, self.width)
        return _coloured(line) if self._colours else line


def _wrapped(line: str, width: int) -> str:
    """Break a line at spaces and indent the rest. A command gets backslashes, so that the shell still reads it."""
    indent = len(line) - len(line.lstrip())
    is_command = line.startswith("next: ")
    hanging = " " * min(indent + 2, width // 2)
    room = width - 2 if is_command else width
    lines = [""]
    for word in re.findall(r"""\s*(?:'[^']*'|"[^"]*"|\S)+""" if is_command else r"\s*\S+", line):
        if len(lines[-1]) + len(word) > room and lines[-1].strip():
            lines.append(hanging + word.lstrip())
        else:
            lines[-1] += word
    return (" \\\n" if is_command else "\n").join(lines)


def _coloured(line: str) -> str:
    for pattern, colour in _COLOURS:
        if match := re.match(pattern, line):
            return f"{colour}{match[0]}{_PLAIN}{line[match.end() :]}"
    return line
