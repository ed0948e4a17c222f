"""The progress of conversions, by the messages of a recording in which all seconds are alike."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from benchmarks.long import Long
from support import sampled

if TYPE_CHECKING:
    from pathlib import Path

#: Forty seconds of small clouds.
SHORT = Long(clouds=400, points=4_096)


def progress_of(source: Path, folder: Path, **options: Any) -> list[tuple[int, int, int]]:
    told: list[tuple[int, int, int]] = []
    pc2scan.convert(
        source,
        folder / "scans.mcap",
        overwrite=True,
        min_height=-2,
        progress=lambda *step: told.append(step),
        **options,
    )
    return told


OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "only scans": {"keep": []},
    "a cut": {"keep": [], "start": 10.0, "end": 30.0},
    "chunks": {"keep_clouds": True},
    "threads": {"keep_clouds": True, "jobs": 2},
    "moving": {"target_frame": "base_link", "fixed_frame": "odom", "deskew": True},
}


@pytest.mark.parametrize(("name", "case"), sampled(product(["a.mcap"], OPTIONS), 2))
def test_progress_is_the_bytes_read_of_those_in_all(name: str, case: str, tmp_path: Path) -> None:
    source = SHORT.write(tmp_path / name)
    told = progress_of(source, tmp_path, **OPTIONS[case])
    dones = [done for done, _, _ in told]
    assert dones == sorted(dones)
    assert (dones[0], dones[-1]) == (0, told[-1][1])
    # What is read ahead is read again; of a database only the transforms are.
    size = sum(path.stat().st_size for path in (source.iterdir() if source.is_dir() else [source]))
    share = {"a cut": 0.5, "moving": 1 if name == "a" else 2}.get(case, 1)
    assert dones[-1] == pytest.approx(share * size, rel=0.1)
