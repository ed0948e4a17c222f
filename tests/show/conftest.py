"""One browser for all tests of a worker."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from show.browser import chromium

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    with chromium() as tab:
        yield tab
