"""The corpus, and mutations of it that are the same every time."""

from __future__ import annotations

import random

import pytest

from fuzz.decoders import CORPUS, DECODERS, decode
from fuzz.mutants import damaged
from fuzz.seeds import Seed
from support.bounded import watched

#: Mutants of each input, in the quick run and in the long one.
_QUICK, _LONG = 20, 50


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Damage bytes once, and at times more often."""
    seed = Seed("", {"data": data or b"\0"}, "data")
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        data = damaged(seed, rng).data or b"\0"
        seed = Seed("", {"data": data}, "data")
    return data


@pytest.mark.parametrize("count", [_QUICK, pytest.param(_LONG, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", DECODERS)
def test_decoders_answer_or_raise_their_own_errors(name: str, count: int) -> None:
    files = sorted((CORPUS / name).iterdir())
    assert files
    rng = random.Random(name)
    for file in files:
        sound = file.read_bytes()
        for data in (sound, b"", *(mutated(sound, rng) for _ in range(count))):
            with watched(len(data)):
                decode(name, data)
