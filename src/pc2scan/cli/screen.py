"""Fits standard output and error to the terminal: wraps lines at its width, and colours them if it shows colours.

Both work on lines as they are written, so that no command has to deal with it. Pipes and files get every line
unchanged, even if COLUMNS is set: shells and Python's readline also set it for programs whose output is read by others.
"""

from __future__ import annotations

import os
import re
from typing import Any, TextIO

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

#: Verdicts of ``check``, which follow the name of a consumer.
_VERDICT = r"  \w+ +(accepted|misplaced|ignored|aborts)\b"
_VERDICTS = {"accepted": _GREEN, "misplaced": _YELLOW, "ignored": _RED, "aborts": _RED}


class StdoutError(Exception):
    """Standard output cannot be written; ``args[0]`` is the operating system's error."""


def width_of(stream: Any) -> int | None:
    """Return the maximum width of lines on a stream in columns; None for no limit."""
    try:
        if not stream.isatty():
            return None
        asked = os.environ.get("COLUMNS", "")
        columns = int(asked) if asked.isdecimal() else os.get_terminal_size(stream.fileno()).columns
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
        try:
            return self._stream.write(text)
        except OSError as err:
            if self._guarded:
                raise StdoutError(err) from err
            raise

    def flush(self) -> None:
        """Flush."""
        try:
            self._stream.flush()
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
    verdict = re.match(_VERDICT, line)
    if verdict:
        start, end = verdict.span(1)
        return f"{line[:start]}{_VERDICTS[verdict[1]]}{line[start:end]}{_PLAIN}{line[end:]}"
    for pattern, colour in _COLOURS:
        found = re.match(pattern, line)
        if found:
            return f"{colour}{found[0]}{_PLAIN}{line[found.end() :]}"
    return line
