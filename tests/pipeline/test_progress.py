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


@pytest.mark.parametrize(("name", "case"), sampled(product(["a.mcap", "a.bag", "a"], OPTIONS), 4))
def test_the_share_of_the_work_is_that_of_the_messages(name: str, case: str, tmp_path: Path) -> None:
    told = progress_of(SHORT.write(tmp_path / name), tmp_path, **OPTIONS[case])
    dones, totals = [done for done, _, _ in told], [total for _, total, _ in told]
    assert dones == sorted(dones)
    assert (dones[0], dones[-1]) == (0, totals[-1])
    # What is found out before the first message is known ahead, too.
    assert totals[0] == pytest.approx(totals[-1], rel=0.05)
    converting = [step for step in told if step[2]]
    messages = converting[-1][2]
    before = converting[0][0] if case == "moving" else 0
    for done, total, number in converting[:-1]:
        # A unit that is loaded counts when the next one is due.
        assert (done - before) / (total - before) == pytest.approx(number / messages, abs=0.06)


#: Exports and maps that read transforms ahead, and whether they convert clouds.
AHEAD: dict[str, tuple[str, bool, dict[str, Any]]] = {
    "a map of clouds": ("map", True, {"odom_frame": "odom"}),
    "a map of scans": ("map", False, {"odom_frame": "odom"}),
    "scans of clouds": ("export", True, {"target_frame": "base_link"}),
    "scans with poses": ("export", False, {"pose_frame": "odom"}),
}


@pytest.mark.parametrize("case", AHEAD)
def test_what_exports_and_maps_read_ahead_counts(case: str, tmp_path: Path) -> None:
    command, converts, options = AHEAD[case]
    source = Long(clouds=100, points=4_096, scanned=True).write(tmp_path / "a.mcap")
    parameters = {"min_height": -2} if converts else {}
    if not converts:
        pc2scan.convert(source, tmp_path / "b.mcap", min_height=-2)
        source = tmp_path / "b.mcap"

    def told_by(function: Any, *arguments: Path, **further: Any) -> list[tuple[int, int, int]]:
        told: list[tuple[int, int, int]] = []
        function(source, *arguments, progress=lambda *step: told.append(step), **parameters, **further)
        dones = [done for done, _, _ in told]
        assert dones == sorted(dones)
        assert {total for _, total, _ in told} == {dones[-1]}
        assert told[-1][2] == 100
        return told

    plain = told_by(pc2scan.export, tmp_path / "plain.npz")
    arguments = [tmp_path / "scans.npz"] if command == "export" else []
    told = told_by(getattr(pc2scan, command), *arguments, **options)
    ahead = told[-1][0] - plain[-1][0]
    assert 0.1 < ahead / told[-1][0] < 0.5
    # The conversion begins when all of it has been read.
    assert (ahead, told[-1][1], 0) in told


def test_clouds_that_are_exported_are_written(tmp_path: Path) -> None:
    source = Long(clouds=100, points=4_096, scanned=True).write(tmp_path / "a.mcap")
    totals: dict[str, int] = {}
    for name in ("scans.npz", "clouds"):
        options: dict[str, Any] = {"format": "kitti"} if name == "clouds" else {"min_height": -2}
        pc2scan.export(
            source, tmp_path / name, progress=lambda *step, name=name: totals.update({name: step[1]}), **options
        )
    size = 100 * 4_096 * 32
    # So clouds with poses: what is read ahead for these is a small part of the work.
    assert totals["clouds"] - totals["scans.npz"] > 2 * size
