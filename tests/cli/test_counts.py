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
    "plot --frames 10000000 -o a.png": "--clouds is 10000000, it must be from 1 to 24",
    "convert -o a.bag --jobs 1000000": "--jobs is 1,000,000, it must be from 0 to 1,024",
    "batch -o out --jobs 1000000": "--jobs is 1,000,000, it must be from 0 to 1,024",
    "batch -o out --retries 1000000": "--retries is 1,000,000, it must be from 0 to 100",
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


CUTS = {
    "--start 1000000000000000000000000000000": "outside of the recording: --start is 1000000000000000000000.",
    "--end 0": "outside of the recording: --end is 1700000000.000000000",
    "--start 0.3 --end 0.1": "the cut is empty: start is not before end",
}


@pytest.mark.parametrize("command", ["convert -o a.bag", "view -o a.html", "plot -o a.png"])
@pytest.mark.parametrize("cut", CUTS)
def test_a_cut_without_messages_is_wrong_usage(
    cut: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name, *options = command.split()
    ended = run_command([name, HALL, *options, *cut.split()])
    assert ended.status == 2
    assert CUTS[cut] in ended.messages
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("tolerance", ["inf", "1e308", "1e30"])
@pytest.mark.parametrize(
    "command", ["convert -o a.bag", "convert -o a.bag --deskew --fixed-frame odom", "view -o a.html"]
)
def test_a_tolerance_without_limit_takes_any_transform(
    command: str, tolerance: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name, *options = command.split()
    long = ["--target-frame", "base_link", "--min-height", "0.2", "--transform-tolerance"]
    results = set()
    for given in (tolerance, "3600"):
        ended = run_command([name, HALL, *options, *long, given])
        (made,) = tmp_path.iterdir()
        results.add((ended.status, made.read_bytes()))
        made.unlink()
    assert len(results) == 1


def test_a_size_of_files_is_text_also_in_python(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"split is 5 \(int\), it must be a str, or None"):
        pc2scan.convert(HALL, tmp_path / "a.bag", split=5)  # type: ignore[arg-type]


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
