"""Shell completion of presets and choices, and of the topics and frames of the recording that was typed.

A shell waits for it at each Tab. So it takes at most a second, and offers nothing if anything goes wrong.
"""

from __future__ import annotations

import itertools
import os
import shlex
import signal
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.options.table import GROUPS, options_of
from pc2scan.options.values import PathName

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

#: Time limit in seconds; what was found by then is offered.
_PATIENCE = 1.0


class _TooLateError(Exception):
    """The time limit is reached."""


def offered(offers: Sequence[str], incomplete: str) -> list[str]:
    """Return what the shell offers: see `pc2scan.options.values.Value.offers`; or ``words`` and the words."""
    kind, *words = offers
    if kind == "topics":
        return _topics(words, incomplete)
    if kind == "frames":
        return frames(incomplete)
    return [word for word in words if word.startswith(incomplete)]


def _topics(endings: Sequence[str], incomplete: str) -> list[str]:
    """Offer the topics of the typed recordings whose type ends with one of these; without any, all topics."""
    found: set[str] = set()
    with _patiently():
        from pc2scan.show.naming import topics_in

        found.update(topics_in(_typed(), tuple(endings)))
    return _fitting(found, incomplete)


def frames(incomplete: str) -> list[str]:
    """Offer the frames that have transforms in the recordings that were typed."""
    found: set[str] = set()
    with _patiently():
        from pc2scan.show.naming import frames_in

        # Added one by one, so that those found within the time limit are offered.
        for name in frames_in(_typed()):
            found.add(name)
    return _fitting(found, incomplete)


def _fitting(found: set[str], incomplete: str) -> list[str]:
    # Names with control characters are not offered: the shell would send them to the terminal unescaped.
    return sorted(name for name in found if name.startswith(incomplete) and name.isprintable())


def _typed() -> list[Path]:
    """Return the recordings on the command line.

    They are read from the words of the shell, because Typer's parser has no arguments while an option has no value yet.
    """
    line = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS") or ""
    try:
        words = shlex.split(line)
    except ValueError:  # a quotation that is still open
        words = line.split()
    pairs = itertools.pairwise(words[1:])
    others = {"-o", "--output", *(option.spelling for option in _file_options(words[1:2]))}
    return [
        Path(word)
        for before, word in pairs
        if not word.startswith("-") and before not in others and os.path.exists(word)  # noqa: PTH110
    ]


def _file_options(command: list[str]) -> Iterator[Any]:
    """Yield the options of a command that take files other than recordings."""
    for name in command:
        if name in GROUPS:
            for option in options_of(name).values():
                if isinstance(option.value, PathName) and not option.value.is_recording:
                    yield option


@contextmanager
def _patiently() -> Iterator[None]:
    """End the body at the time limit or at any error, and ignore the error."""

    def stop(*_: Any) -> None:
        raise _TooLateError

    # Windows has no such timer, so there is no time limit there.
    timed = hasattr(signal, "setitimer")
    if timed:
        previous = signal.signal(signal.SIGALRM, stop)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE)
    # Errors of a recording are not shown during completion.
    with suppress(Exception):
        yield
    if timed:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
