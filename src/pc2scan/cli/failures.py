"""Shows errors, and returns their exit statuses; Typer's texts are turned into errors of our style."""

from __future__ import annotations

import errno
import os
import re
import signal
from typing import TYPE_CHECKING

from pc2scan.errors import DamageError, Pc2ScanError, UsageError
from pc2scan.files.system import is_full
from pc2scan.options.keywords import meant_by
from pc2scan.options.table import GROUPS, instead_of, options_of
from pc2scan.text import did_you_mean, shell_word
from pc2scan.version import __version__

from .render import as_typed, print_json, say, show_error

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Commands whose exit status 1 is a verdict; their status for errors is 2.
VERDICTS = frozenset({"check", "diff", "golden"})

#: Commands that have written their output when they begin to print.
_WRITING = frozenset({"batch", "convert", "export", "map", "repair", "view"})


def show_failure(err: Pc2ScanError, words: Sequence[str]) -> int:
    """Show an error on standard error, and with ``--json`` also as JSON on standard output; return the exit status.

    Parameters
    ----------
    words
        What was typed after ``pc2scan``.
    """
    status = err.exit_status
    if status == 2:  # wrong usage
        err.hint = _meant_as_output(words) or err.hint
    elif is_full(err):
        err.hint = err.hint or "make room on that disk"
    if words[0] in VERDICTS:
        status = 2
        if isinstance(err, DamageError):
            err.hint = "pc2scan repair makes a sound recording of what is readable"
    show_error(err)
    if "--json" in (words[: words.index("--")] if "--" in words else words):
        err.message, err.hint = as_typed(err.message), None if err.hint is None else as_typed(err.hint)
        errors = [err.as_dict()]
        print_json({"pc2scan": __version__, "kind": "failure", "exit_status": status, "errors": errors})
    return status


def end_without_output(err: OSError, words: Sequence[str]) -> int:
    """Return the exit status if standard output cannot be written.

    If the reader of a pipe closed it (``| head``), there is no message, and the exit status is that of a process that
    SIGPIPE ended, like with other tools.
    """
    # Discard the buffer: otherwise the interpreter writes it when it ends, and fails again.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    # Windows has no SIGPIPE, and reports EINVAL for a closed pipe.
    if err.errno == errno.EPIPE or (os.name == "nt" and err.errno == errno.EINVAL):
        return 128 + getattr(signal, "SIGPIPE", 13)
    command = "" if {"-h", "--help"} & set(words) else "".join(words[:1])
    note = "; the output is written" if command in _WRITING else ""
    say(f"error: standard output cannot be written: {err.strerror}{note}", err=True)
    return 3 if command in _WRITING else 2 if command in VERDICTS else 1


def in_our_words(text: str, command: str) -> UsageError:
    """Convert the text of an error of Typer to an error of ours."""
    hint = f"{f'pc2scan {command}'.rstrip()} --help shows what it takes"
    if unknown := re.match(r"No such option: (\S+)", text):
        known = [option.spelling for option in options_of(command).values()] if command else []
        hint = _instead(command, unknown[1]) or did_you_mean(unknown[1], known) or hint
        return UsageError(f"there is no option {unknown[1]}", hint=hint)
    text = re.sub(r"^Option '(\S+)' ", r"\1 ", text.rstrip("."))
    return UsageError(text[:1].lower() + text[1:], hint=hint)


def _instead(command: str, typed: str) -> str:
    """Return what to use instead of an option that only other commands have, or other tools."""
    name = typed.strip("-").replace("-", "_")
    if not command:
        return ""
    if meant := meant_by(command, name):
        return as_typed(f"did you mean {' and '.join(meant)}?")
    names = [option.name for other in GROUPS for option in options_of(other).values() if option.spelling == typed]
    return as_typed(next(filter(None, (instead_of(command, candidate) for candidate in (name, *names))), ""))


def _meant_as_output(words: Sequence[str]) -> str:
    """Return what to type, if the last word is probably the destination, as with ``cp``; else nothing."""
    last = words[-1]
    if words[0] not in {*_WRITING, "plot"} or {"-o", "--output"} & set(words) or last[0:1] in ("", "-") or ":=" in last:
        return ""
    # The word before is a source, no option that has a value.
    is_new = len(words) > 2 and os.path.lexists(words[-2]) and not os.path.lexists(last)
    return f"did you mean -o {shell_word(last)}?" if is_new else ""
