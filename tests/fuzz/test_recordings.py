"""A few seconds of the fuzzer, the same ones every time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fuzz.recordings import attempt, make_seeds

if TYPE_CHECKING:
    from pathlib import Path

#: Seeds of each test, from the number on; the whole takes a few seconds.
_EACH = 12


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return make_seeds(tmp_path_factory.mktemp("seeds") / "sound")


@pytest.mark.parametrize("first", range(0, 8 * _EACH, _EACH))
def test_mutated_recordings(first: int, seeds: dict[str, Path], tmp_path: Path) -> None:
    for seed in range(first, first + _EACH):
        place = tmp_path / str(seed)
        place.mkdir()
        attempt(seed, seeds, place)
