"""The corpus, and mutations of it that are the same every time."""

from __future__ import annotations

import random

import pytest

from fuzz.decoders import CORPUS, DECODERS, decode
from fuzz.recordings import mutated
from fuzz.watch import watched

#: Of each input; those that write files are slower.
_MUTATIONS = {"bag": 40, "mcap": 40, "rows": 20, "metadata": 10, "schema": 40, "parameters": 20}


@pytest.mark.parametrize("name", DECODERS)
def test_decoders_answer_or_raise_their_own_errors(name: str) -> None:
    files = sorted((CORPUS / name).iterdir())
    assert files
    rng = random.Random(name)
    for file in files:
        sound = file.read_bytes()
        for data in (sound, b"", *(mutated(sound, rng) for _ in range(_MUTATIONS.get(name, 150)))):
            with watched(len(data)):
                decode(name, data)


def test_the_corpus_is_small() -> None:
    assert sum(file.stat().st_size for file in CORPUS.rglob("*") if file.is_file()) < 200_000
