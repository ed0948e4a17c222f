"""Options that are counts: what they may be, and that nothing is allocated for what does not exist."""

from __future__ import annotations

import tracemalloc
from functools import partial
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.cli.in_process import run_command
from support import ROOT

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HALL = str(ROOT / "fixtures" / "hall.bag")

REFUSED = {
    "view -o a.html --clouds 10000000": "--clouds is 10,000,000, it must be from 1 to 1,000",
    "plot --frames 10000000 -o a.png": "frames is 10000000, it must be from 1 to 24",
    "convert -o a.bag --jobs 1000000": "--jobs is 1,000,000, it must be from 0 to 1,024",
    "batch -o out --jobs 1000000": "--jobs is 1,000,000, it must be from 0 to 1,024",
    "convert -o a.bag --reduce kth --kth 99999999999999999999": (
        "kth is 99,999,999,999,999,999,999, it must be at most 2,147,483,647"
    ),
    "convert -o a.bag --min-points 99999999999999999999": (
        "min_points is 99,999,999,999,999,999,999, it must be at most 2,147,483,647"
    ),
    "convert -o a.bag --beams 10000000": "beams is 10,000,000, it must be from 2 to 4,000,000",
    "convert -o a.bag --accumulate 999999clouds": "--accumulate is '999999clouds', it must be 1 to 100,000 clouds",
}


@pytest.mark.parametrize("words", REFUSED)
def test_a_count_beyond_its_range_names_the_range(words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    command, *options = words.split()
    ended = run_command([command, HALL, *options])
    assert ended.status == 2
    assert f"error: {REFUSED[words]}" in ended.messages
    assert list(tmp_path.iterdir()) == []


def peak_of(work: Callable[[], object]) -> int:
    """The most memory that Python's objects take meanwhile, bytes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_more_samples_than_clouds_take_no_more_memory() -> None:
    pc2scan.info(HALL)
    few, many = (peak_of(partial(pc2scan.info, HALL, samples=count)) for count in (5, 3_000_000))
    assert many < few + 1_000_000


def test_more_samples_than_clouds_describe_the_same() -> None:
    assert str(pc2scan.info(HALL, samples=10**30)) == str(pc2scan.info(HALL, samples=5))


def test_more_clouds_than_there_are_make_the_same_page() -> None:
    assert pc2scan.view(HALL, clouds=1000).html == pc2scan.view(HALL, clouds=5).html
