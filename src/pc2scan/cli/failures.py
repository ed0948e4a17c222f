"""Shows errors, and returns their exit statuses; Typer's texts are turned into errors of our style."""

from __future__ import annotations

import errno
import os
import re
import signal
from difflib import get_close_matches
from typing import TYPE_CHECKING

from pc2scan.errors import DamageError, Pc2ScanError, UsageError
from pc2scan.files.system import is_full
from pc2scan.options.keywords import meant_by
from pc2scan.options.table import GROUPS, instead_of, options_of
from pc2scan.result import Failure
from pc2scan.text import did_you_mean, shell_word

from .commands import COMMANDS
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
    err.hint = _mistyped(err, words) or err.hint or ("make room on that disk" if is_full(err) else None)
    command = words[0]
    status = err.exit_status
    if command in VERDICTS:
        status = max(status, 2)
        if isinstance(err, DamageError):
            err.hint = "pc2scan repair makes a sound recording of what is readable"
    show_error(err)
    if "--json" in (words[: words.index("--")] if "--" in words else words):
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


def in_our_words(text: str, typed: Sequence[str]) -> UsageError:
    """Convert the text of an error of Typer to an error of ours; ``typed`` is what was typed after ``pc2scan``."""
    command = typed[0] if typed[0] in COMMANDS else ""
    hint = f"{f'pc2scan {command}'.rstrip()} --help shows what it takes"
    if unknown := re.match(r"No such option: (\S+)", text):
        option = unknown[1]
        if instead := _instead(command, option):
            hint = instead
        elif option == "--json":
            hint = "--report report.json writes a report as JSON"
        elif near := _near_options(command, option):
            hint = f"did you mean {' or '.join(near)}?"
        elif file := next((word for word in typed if word.startswith("-") and os.path.lexists(word)), None):
            hint = f"for the file of this name, type ./{file}"
        return UsageError(f"there is no option {option}", hint=hint)
    if not command and not typed[0].startswith("-"):
        return _no_command(typed)
    if text.startswith("Got unexpected extra argument"):
        hint = _meant_as_output(typed) or hint
    text = re.sub(r"^Option '(\S+)' ", r"\1 ", text.rstrip("."))
    return UsageError(text[:1].lower() + text[1:], hint=hint)


def _no_command(typed: Sequence[str]) -> UsageError:
    """Return the error about a first word that is no command."""
    name = typed[0]
    hint = did_you_mean(name, COMMANDS) or "pc2scan --help shows what it takes"
    if os.path.lexists(name):
        hint = f"the command comes first: pc2scan info {shell_word(name)}"
    elif name in {"help", "version"}:
        hint = " ".join(("pc2scan", *(word for word in typed[1:2] if word in COMMANDS), f"--{name}"))
    return UsageError(f"no such command {name!r}", hint=hint)


def _mistyped(err: Pc2ScanError, words: Sequence[str]) -> str:
    """Return what to type instead, if a word was taken for something else than it was meant as; else nothing."""
    if err.path is not None and (name := str(err.path)) in words and not os.path.lexists(name):
        before = words[words.index(name) - 1]
        if name.lower() in {"true", "false", "on", "off", "yes", "no"} and before.startswith("--"):
            off = name.lower() in {"false", "off", "no"}
            return f"an option such as {before} takes no value: {before.replace('--', '--no-', 1) if off else before}"
        if any(sign in name for sign in "*?[") and len(words) > 1:
            return "the shell replaces * only without quotes; pc2scan batch converts each of several recordings"
        if name == words[-1] and (hint := _meant_as_output(words)):
            return hint
    if err.message.endswith(" is missing") and (hint := _meant_as_output(words)):
        return hint
    if "--static-tf" in words and isinstance(err, UsageError):
        begin = words.index("--static-tf") + 1
        count = next((n for n in (9, 8) if _is_transform(words[begin : begin + n])), 0)
        if count:
            return f"it is one argument, in quotes: --static-tf {shell_word(' '.join(words[begin : begin + count]))}"
    return ""


def _meant_as_output(words: Sequence[str]) -> str:
    """Return what to type, if the last word is probably the destination, as with ``cp``; else nothing."""
    command, last = words[0], words[-1]
    if command not in {*_WRITING, "plot"} or len(words) < 3 or {"-o", "--output"} & set(words):
        return ""
    # The word before is a source, no option that has a value.
    is_new = os.path.lexists(words[-2]) and not os.path.lexists(last)
    return f"did you mean -o {shell_word(last)}?" if is_new else ""


def _is_transform(words: Sequence[str]) -> bool:
    """Return whether words are the parts of a static transform: two frames, and six or seven numbers."""
    try:
        return len([float(word) for word in words[2:]]) in (6, 7) and " " not in words[0]
    except ValueError:
        return False


def _instead(command: str, typed: str) -> str:
    """Return what to use instead of an option that only other commands have, or other tools."""
    if command and (meant := meant_by(command, typed.strip("-").replace("-", "_"))):
        return as_typed(f"did you mean {' and '.join(meant)}?")
    names = [name for name in (typed.strip("-").replace("-", "_"),) if command]
    names += [option.name for other in GROUPS for option in options_of(other).values() if option.spelling == typed]
    return next((as_typed(text) for name in names if (text := instead_of(command, name))), "")


def _near_options(command: str, typed: str) -> list[str]:
    """Return the options similar to the typed one; if one differs only in its underscores, only that one."""
    plain = typed.strip("-").replace("_", "-").lower()
    options = [option.spelling.strip("-") for option in options_of(command).values()] if command else []
    return [f"--{near}" for near in ([plain] if plain in options else get_close_matches(plain, options))]
