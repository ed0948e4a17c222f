"""Handles Ctrl-C while modules are loaded, and after the command is done; and the signals that end a command."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager, suppress

# Instead of typing.TYPE_CHECKING: to load typing takes too long before interruptions are handled.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType


def _end(number: int, _frame: FrameType | None) -> None:
    os._exit(128 + number)


@contextmanager
def quiet_interrupts() -> Iterator[None]:
    """End the process without a message if it is interrupted, except in `interruptible`.

    An exception raised while a module is loaded would show a traceback, or look like a missing library.
    """
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _end)
    try:
        yield
    finally:
        if ours:
            # The command is done and its exit status is known, so interruptions no longer matter.
            signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def interruptible(terminate: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Let an interruption raise KeyboardInterrupt, so that no partial output stays; what ends it calls ``terminate``.

    That is SIGTERM, and SIGHUP of a terminal that is closed, unless it is ignored as under ``nohup``.
    """
    ours = signal.getsignal(signal.SIGINT) is _end
    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sent = [signal.SIGTERM]
    # Windows has no terminals that are closed.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        sent.append(signal.SIGHUP)
    previous = {}
    # Only the main thread may set handlers. In another thread, the program around this handles signals.
    with suppress(ValueError):
        previous = {number: signal.signal(number, terminate) for number in sent}
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGINT, _end)
        for number, handler in previous.items():
            if handler is not None:
                signal.signal(number, handler)
