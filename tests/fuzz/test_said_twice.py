"""Facts that a file has twice: if one of them is changed, and checksums are right, nothing is lost.

It is reported if reading depends on it, as no reader knows which of the two is right. What only repeats the content
for an index may be wrong without a word: the content wins.
"""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from fuzz.judge import REPAIR, Outcome, attempt
from fuzz.mutants.mutate import field_mutant
from fuzz.mutants.seeds import Seed, make_seeds

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

#: Seeds, records, and those of their fields that something else in the file says, too.
_NEEDED = {
    "bag-lz4": {
        "bag_header": "chunk_count conn_count index_pos",
        "chunk": "size",
        "chunk_info": "chunk_pos conn conn_count count ver",
        "connection": "conn",
    },
    "mcap-zstd": {
        "chunk": "uncompressed_size",
        "chunk_index": "chunk_length chunk_start compressed_size compression message_index_length uncompressed_size",
        "footer": "summary_start",
        "statistics": "channel_message_counts.channel_id channel_message_counts.count message_count",
    },
    "mcap-none-without-crc": {"chunk": "crc"},
    "db3": {"index": "id time"},
}

#: The same for fields that only repeat what is read anyway.
_REPEATED = {
    "bag-lz4": {"index_data": "conn offset time"},
    "mcap-zstd": {
        "attachment_index": "create_time data_size length log_time media_type name offset",
        "message_index": "channel_id entries.offset entries.time",
        "metadata_index": "length name offset",
        "statistics": "channel_count chunk_count schema_count",
    },
}


def kinds(said: Mapping[str, Mapping[str, str]]) -> list[tuple[str, str]]:
    return [
        (seed, f"{record}.{field}")
        for seed, records in said.items()
        for record, fields in records.items()
        for field in fields.split()
    ]


@pytest.fixture(scope="module")
def seeds() -> dict[str, Seed]:
    return {seed.name: seed for seed in make_seeds()}


NUMBERS = pytest.mark.parametrize("numbers", [range(1), pytest.param(range(1, 8), marks=pytest.mark.slow)], ids=str)


@NUMBERS
@pytest.mark.parametrize(("name", "kind"), kinds(_NEEDED))
def test_a_needed_fact_that_is_said_otherwise_is_reported(
    name: str, kind: str, numbers: range, seeds: dict[str, Seed], tmp_path: Path
) -> None:
    for number in numbers:
        made = field_mutant(seeds[name], kind, random.Random(number))
        (tmp_path / str(number)).mkdir()
        outcome = attempt(made, REPAIR, tmp_path / str(number))
        # In MCAP, zero says nothing.
        if not (made.name.endswith(".mcap") and made.edit.how.startswith("zero")):
            assert outcome == Outcome.identical_reported, str(made)
        assert outcome in (Outcome.identical_reported, Outcome.identical), str(made)


@NUMBERS
@pytest.mark.parametrize(("name", "kind"), kinds(_REPEATED))
def test_a_repeated_fact_that_is_said_otherwise_loses_nothing(
    name: str, kind: str, numbers: range, seeds: dict[str, Seed], tmp_path: Path
) -> None:
    for number in numbers:
        made = field_mutant(seeds[name], kind, random.Random(number))
        (tmp_path / str(number)).mkdir()
        outcome = attempt(made, REPAIR, tmp_path / str(number))
        assert outcome in (Outcome.identical_reported, Outcome.identical), str(made)
