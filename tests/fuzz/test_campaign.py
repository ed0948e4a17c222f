"""Some mutants of the campaign, the same ones every time, and its oracle on sound recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fuzz.contradictions.recording import contradictions
from fuzz.judge import attempt, mutant_of, rearranged_of
from fuzz.mutants.seeds import Seed, make_seeds

if TYPE_CHECKING:
    from pathlib import Path

#: Numbers of mutants: the first one, and how many in each test and in all.
_FIRST, _EACH, _ALL = 10_000, 15, 120


@pytest.fixture(scope="module")
def seeds() -> list[Seed]:
    return make_seeds()


def test_nothing_contradicts_in_sound_recordings(seeds: list[Seed]) -> None:
    assert {seed.name: found for seed in seeds if (found := contradictions(seed.files))} == {}


@pytest.mark.parametrize("first", range(_FIRST, _FIRST + _ALL, _EACH))
def test_no_mutant_is_lost_without_a_word(first: int, seeds: list[Seed], tmp_path: Path) -> None:
    for number in range(first, first + _EACH):
        folder = tmp_path / str(number)
        folder.mkdir()
        attempt(*mutant_of(number, seeds), folder)


@pytest.mark.parametrize("first", range(_FIRST, _FIRST + 2 * _ALL, 2 * _EACH))
def test_no_reader_finds_more_messages(first: int, seeds: list[Seed], tmp_path: Path) -> None:
    """Records are removed, repeated, moved or exchanged; nor is it said that nothing is lost if something is."""
    for number in range(first, first + 2 * _EACH):
        folder = tmp_path / str(number)
        folder.mkdir()
        attempt(*rearranged_of(number, seeds), folder)
