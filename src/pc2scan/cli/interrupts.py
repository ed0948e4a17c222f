"""Handles Ctrl-C while modules are loaded, and after the command is done."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager

# As typing has it, which takes longer to load than an interruption should be possible before.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

__all__ = ["interruptible", "quiet_interrupts"]


def _end(number: int, _frame: FrameType | None) -> None:
    os._exit(128 + number)


@contextmanager
def quiet_interrupts() -> Iterator[None]:
    """End the process without a word if it is interrupted, but for what is `interruptible`.

    An exception raised while a module is loaded would be a traceback, or be taken for a library that is missing.
    """
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _end)
    try:
        yield
    finally:
        if ours:
            # What was asked for is done, and its exit status is known.
            signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let an interruption raise KeyboardInterrupt, so that no partial output stays."""
    ours = signal.getsignal(signal.SIGINT) is _end
    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGINT, _end)
