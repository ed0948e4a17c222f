"""Some mutants of the campaign, the same ones every time, and files that are damaged at any byte."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fuzz.campaign import mutant_of
from fuzz.judge import attempt
from fuzz.mutants import at_each
from fuzz.records import edges, stretches
from fuzz.seeds import Seed, make_seeds, make_small_seeds
from support import sampled

if TYPE_CHECKING:
    from pathlib import Path


def test_no_mutant_is_lost_without_a_word(tmp_path: Path) -> None:
    seeds = make_seeds()
    for number in range(10_000, 10_012):
        attempt(mutant_of(number, seeds), tmp_path / str(number))


def places(seed: Seed, step: int) -> set[int]:
    """Where a file is damaged, with the edges of its records; a bag header's padding is all alike."""
    ((name, data),) = seed.files.items()
    bounds = {edge - back for edge in edges(name, data) for back in (0, 1)} - {len(data)}
    first = 13 if name.endswith(".bag") else 8
    spread = {*range(first, 150, step), *range(4100 if first == 13 else first, len(data), step)}
    return {place for place in bounds | spread if place >= first}


# From one place to the next: prime numbers.
@pytest.mark.parametrize("step", [197, pytest.param(29, marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", sampled(make_small_seeds(), 3), ids=lambda seed: seed.name)
def test_damage_costs_no_more_than_its_chunk(seed: Seed, step: int, tmp_path: Path) -> None:
    assert stretches(*seed.files.values())
    for made in at_each(seed, sorted(places(seed, step))):
        attempt(made, tmp_path / "mutant", repair=False)
