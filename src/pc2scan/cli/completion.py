"""What the shell offers: presets and choices, and the topics and frames of the recording that was typed.

A shell waits for it at each Tab: it takes at most a second, and whatever goes wrong, it offers nothing.

No ``from __future__ import annotations`` here: at every start Typer reads the annotations of each of these functions,
and would compile text.
"""

import itertools
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

__all__ = ["choices", "frames", "presets", "topics"]

#: Seconds until what was found by then is offered.
_PATIENCE = 1.0

#: Options whose files are not recordings.
_OTHER_FILES = frozenset({"-o", "--output", "--params-file", "--static-tf-file", "--report", "--junit"})


class _TooLateError(Exception):
    """Time is up."""


def choices(words: Iterable[str]) -> Callable[[str], list[str]]:
    """Offer words."""
    offered = list(words)
    return lambda incomplete: [word for word in offered if word.startswith(incomplete)]


def presets(incomplete: str) -> list[str]:
    """Offer the presets."""
    from pc2scan.core.presets import PRESETS

    return choices(PRESETS)(incomplete)


def topics(*endings: str) -> Callable[[str], list[str]]:
    """Offer the topics of the recordings that were typed, of types with these endings; of any type without."""

    def offered(incomplete: str) -> list[str]:
        found: set[str] = set()
        with _patiently():
            from pc2scan.inspect.naming import topics_in

            found.update(topics_in(_typed(), endings))
        return _fitting(found, incomplete)

    return offered


def frames(incomplete: str) -> list[str]:
    """Offer the frames that have transforms in the recordings that were typed."""
    found: set[str] = set()
    with _patiently():
        from pc2scan.inspect.naming import frames_in

        # One by one, so that what was found counts when time is up.
        for name in frames_in(_typed()):
            found.add(name)
    return _fitting(found, incomplete)


def _fitting(found: set[str], incomplete: str) -> list[str]:
    # The shell gets names as they are: those with control characters would be orders to the terminal.
    return sorted(name for name in found if name.startswith(incomplete) and name.isprintable())


def _typed() -> list[Path]:
    """The recordings on the command line. While an option lacks its value, Typer's parser knows of no arguments."""
    import shlex

    line = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS") or ""
    try:
        words = shlex.split(line)
    except ValueError:  # a quotation that is still open
        words = line.split()
    pairs = itertools.pairwise(words[1:])
    return [
        Path(word)
        for before, word in pairs
        if not word.startswith("-") and before not in _OTHER_FILES and os.path.exists(word)  # noqa: PTH110
    ]


@contextmanager
def _patiently() -> Iterator[None]:
    """End the body when time is up, and with any error; what it found by then counts."""

    def stop(*_: Any) -> None:
        raise _TooLateError

    # Windows has no such timer: there, completion waits.
    timed = hasattr(signal, "setitimer")
    if timed:
        previous = signal.signal(signal.SIGALRM, stop)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE)
    # Whatever is wrong with a recording, it is not said here.
    with suppress(Exception):
        yield
    if timed:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
