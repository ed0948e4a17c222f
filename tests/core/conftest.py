from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.core import kernel
from support.loops import loops_in_numpy

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(params=["compiled", "plain"], scope="module")
def loops(request: pytest.FixtureRequest) -> Iterator[None]:
    """What is tested holds for the compiled loops over points and for those in NumPy."""
    if request.param == "plain":
        with loops_in_numpy():
            yield
    elif kernel.COMPILED:
        yield
    else:
        pytest.skip("there was no C compiler: this installation has no compiled loops")
