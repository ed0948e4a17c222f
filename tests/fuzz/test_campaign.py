"""Some mutants of the campaign, the same ones every time, and its oracle on sound recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fuzz.contradictions.recording import contradictions
from fuzz.judge import attempt, mutant_of, rearranged_of
from fuzz.mutants.seeds import Seed, make_seeds
from support import sampled

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from fuzz.judge import Operation
    from fuzz.mutants.mutate import Mutant

#: Numbers of mutants; each test has some of them.
_NUMBERS = range(10_000, 10_720, 15)


@pytest.fixture(scope="module")
def seeds() -> list[Seed]:
    return make_seeds()


def test_nothing_contradicts_in_sound_recordings(seeds: list[Seed]) -> None:
    assert {seed.name: found for seed in seeds if (found := contradictions(seed.files))} == {}


# Rearranged: records are removed, repeated, moved or exchanged; nor is it said that nothing is lost if something is.
@pytest.mark.parametrize("make", [mutant_of, rearranged_of])
@pytest.mark.parametrize("first", sampled(_NUMBERS, 6))
def test_no_mutant_is_lost_without_a_word(
    first: int, make: Callable[[int, Sequence[Seed]], tuple[Mutant, Operation]], seeds: list[Seed], tmp_path: Path
) -> None:
    for number in range(first, first + _NUMBERS.step):
        folder = tmp_path / str(number)
        folder.mkdir()
        attempt(*make(number, seeds), folder)
