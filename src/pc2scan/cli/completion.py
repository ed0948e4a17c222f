"""Shell completion of choices, and of the topics and frames of the recording that was typed.

A shell waits for it at each Tab. So it takes at most a second, and offers nothing if anything goes wrong.
"""

from __future__ import annotations

import os
import shlex
import signal
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.errors import Pc2ScanError

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Time limit in seconds; what was found by then is offered.
_PATIENCE = 1


def offered(offers: Sequence[str], incomplete: str) -> list[str]:
    """Return what the shell offers: see `pc2scan.options.values.Value.offers`; or ``words`` and the words."""
    kind, *words = offers
    names = set(words if kind == "words" else ())
    if kind != "words":
        # Windows has no such timer.
        if hasattr(signal, "SIGALRM"):
            signal.signal(signal.SIGALRM, _stop)
            signal.alarm(_PATIENCE)
        # Errors of a recording are not shown during completion.
        with suppress(Exception):
            from pc2scan.show.tf import names_in

            for path in _typed():
                with suppress(Pc2ScanError):
                    # Added one by one, so that those found within the time limit are offered.
                    for name in names_in(path, tuple(words) or ("",), frames=kind == "frames"):
                        names.add(name)
            signal.alarm(0)
    # Names with control characters are not offered: the shell would send them to the terminal unescaped.
    return sorted(name for name in names if name.startswith(incomplete) and name.isprintable())


def _stop(*_: Any) -> None:
    raise TimeoutError


def _typed() -> list[Path]:
    """Return the files on the command line; those that are no recordings have no names.

    They are read from the words of the shell, because Typer's parser has no arguments while an option has no value yet.
    """
    line = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS") or ""
    try:
        words = shlex.split(line)
    except ValueError:  # a quotation that is still open
        words = line.split()
    return [Path(word) for word in words[2:] if not word.startswith("-") and os.path.exists(word)]  # noqa: PTH110
