"""Shows errors, and returns their exit statuses."""

from __future__ import annotations

import errno
import os
import signal
from typing import TYPE_CHECKING

from pc2scan.errors import DamageError, Pc2ScanError

from .render import as_typed, say, show_error

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
    command = words[0] if words else ""
    status = err.exit_status
    if command in VERDICTS:
        status = max(status, 2)
        if isinstance(err, DamageError):
            err.hint = "pc2scan repair makes a sound recording of what is readable"
    show_error(err)
    if "--json" in (words[: words.index("--")] if "--" in words else words):
        from pc2scan.result import Failure

        from .render import print_json

        err.message, err.hint = as_typed(err.message), None if err.hint is None else as_typed(err.hint)
        print_json(Failure([err]).as_dict() | {"exit_status": status})
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
