"""Files that are cut off anywhere, and of which any byte is changed: all that is sound is read, and damage is told."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import pytest

from fuzz.judge import READ, attempt
from fuzz.mutants.mutate import byte_mutants, stretches
from fuzz.mutants.seeds import Seed, make_small_seeds

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: From one place to the next in the quick run; a prime number. The long one has all others.
_STEP = 41


def places(seed: Seed, step: int) -> list[int]:
    """Where a file can be damaged: behind its first line; a bag header's padding is all alike.

    Edges of chunks and of messages are always among them.
    """
    ((name, data),) = seed.files.items()
    edges = {stop - back for _, stop, _ in stretches(name, data, within_chunks=True) for back in (0, 1)}
    if name.endswith(".bag"):
        return sorted({*range(13, 150, step), *range(4100, len(data), step), *edges, len(data) - 1})
    return sorted({*range(8, len(data), step), *edges, len(data) - 1})


def other_places(seed: Seed) -> list[int]:
    """All places that are not in the quick run."""
    return sorted({*places(seed, 1)} - {*places(seed, _STEP)})


@pytest.mark.parametrize(
    "chosen",
    [
        pytest.param(partial(places, step=_STEP), id="some"),
        pytest.param(other_places, marks=pytest.mark.slow, id="others"),
    ],
)
@pytest.mark.parametrize("seed", make_small_seeds(), ids=lambda seed: seed.name)
def test_damage_costs_no_more_than_its_chunk(seed: Seed, chosen: Callable[[Seed], list[int]], tmp_path: Path) -> None:
    # In one folder, because a file that is written over costs a third of a new one in a new folder.
    for made in byte_mutants(seed, chosen(seed)):
        attempt(made, READ, tmp_path / "mutant")
