"""Ends transfers that are too slow to finish.

The stores' libraries only notice silence. A server that sends a byte now and then is never silent and never done, so
each transfer has a pace: in every minute 64 KiB arrive, or all that was asked for.
"""

from __future__ import annotations

from time import monotonic
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

#: The slowest transfer: so many bytes, or all that are left, arrive in so many seconds.
LEAST_BYTES = 1 << 16
SLOWEST_SECONDS = 60.0

#: The share of these seconds that a request should take.
_USUAL_SHARE = 0.25


class TooSlowError(Exception):
    """A transfer is too slow; the place that is read makes an error for users of it."""

    def __init__(self) -> None:
        super().__init__(f"fewer than {LEAST_BYTES:,} bytes arrived in {SLOWEST_SECONDS:g} seconds")


class Pace:
    """The time until which the next `LEAST_BYTES` of a transfer must have arrived.

    Parameters
    ----------
    clock
        Returns the time, seconds.
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._counted = 0
        self._deadline = clock() + SLOWEST_SECONDS

    def arrived(self, total: int) -> None:
        """Note how many bytes have arrived since the beginning."""
        if total - self._counted >= LEAST_BYTES:
            self._counted = total
            self._deadline = self._clock() + SLOWEST_SECONDS

    def left(self) -> float:
        """Return the seconds that are left.

        Raises
        ------
        TooSlowError
            If there are none.
        """
        left = self._deadline - self._clock()
        if left <= 0:
            raise TooSlowError
        return left


def affordable(size: int, seconds: float) -> int:
    """Return how many bytes a request may ask for, given how long one of this size took.

    >>> affordable(65_536, 0.1), affordable(65_536, 30)
    (9830400, 32768)
    """
    return int(size * _USUAL_SHARE * SLOWEST_SECONDS / max(seconds, 1e-6))


def finished(fs: Any, name: str, *args: object, pace: Pace, **options: Any) -> Any:
    """Call a method of a file system, and return its result.

    Raises
    ------
    TooSlowError
        If it does not keep the pace; it is cancelled then. File systems without a network take the time that they take.
    """
    if not fs.async_impl:
        return getattr(fs, name)(*args, **options)
    # fsspec has loaded both.
    from asyncio import run_coroutine_threadsafe  # noqa: PLC0415
    from concurrent.futures import wait  # noqa: PLC0415

    future = run_coroutine_threadsafe(getattr(fs, f"_{name}")(*args, **options), fs.loop)
    try:
        while not future.done():
            # An interruption by the user waits for as long.
            wait([future], timeout=min(1, pace.left()))
        return future.result()
    finally:
        future.cancel()
