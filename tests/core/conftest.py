from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.core import kernel, plain

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(params=["compiled", "plain"], scope="module")
def loops(request: pytest.FixtureRequest) -> Iterator[None]:
    """What is tested holds for the compiled loops over points and for those in NumPy."""
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "plain":
            for name in ("angles", "apart", "deskew", "follow", "gather", "nodes", "project", "span"):
                patch.setattr(kernel, name, getattr(plain, name))
        elif not kernel.COMPILED:
            pytest.skip("there was no C compiler: this installation has no compiled loops")
        yield


@pytest.fixture(params=[16, 8, 1])
def lanes(request: pytest.FixtureRequest) -> Iterator[None]:
    """Set how many points the compiled loops process at a time; skip what the processor does not support."""
    if not kernel.COMPILED:
        pytest.skip("there was no C compiler: this installation has no compiled loops")
    from pc2scan.core import _kernel  # not everywhere

    possible = _kernel.lanes(request.param) == request.param
    if possible:
        yield
    _kernel.lanes(16)
    if not possible:
        pytest.skip(f"the processor has no vectors of {request.param} numbers")
