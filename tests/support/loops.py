"""The loops over points, of which there are two: compiled ones, with vectors of several widths, and those in NumPy."""

from __future__ import annotations

from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

import pytest

from pc2scan.core import kernel, plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

needs_compiled = pytest.mark.skipif(not kernel.COMPILED, reason="there was no C compiler")

_NAMES = ("angles", "deskew", "follow", "gather", "nodes", "project", "span", "trace")


@contextmanager
def loops_in_numpy() -> Iterator[None]:
    """Put the loops in NumPy in the place of the compiled ones."""
    with pytest.MonkeyPatch.context() as patch:
        for name in _NAMES:
            patch.setattr(kernel, name, getattr(plain, name))
        yield


#: What each block of a test runs in that holds for both.
BOTH_LOOPS: list[Callable[[], AbstractContextManager[None]]] = [
    *([nullcontext] if kernel.COMPILED else []),
    loops_in_numpy,
]


@contextmanager
def points_at_a_time(most: int) -> Iterator[None]:
    """Let the compiled loops process at most so many points at a time: 16, 8 or 1; fewer if the processor cannot."""
    from pc2scan.core import _kernel  # not everywhere

    _kernel.lanes(most)
    try:
        yield
    finally:
        _kernel.lanes(16)
