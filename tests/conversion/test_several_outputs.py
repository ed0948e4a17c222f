"""Several outputs of one conversion: each as if it were alone."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.core.scene import JUDGED_CLOUDS
from pc2scan.errors import TransformError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path


HALL = ROOT / "fixtures" / "hall.mcap"
BAND = {"min_height": -0.3, "max_height": 1.0}
LOST = {**BAND, "target_frame": "nowhere"}
BASE = {**BAND, "target_frame": "base_link"}
SCANS: dict[str, dict[str, Any]] = {
    "/low": {**BAND, "max_height": 0.2},
    "/base": {**BASE, "geometry": "centered", "beams": 720},
    "/base_far": {**BASE, "range_min": 2.0, "reduce": "median", "intensity_field": "intensity"},
    "/bright": {**BASE, "where": "intensity > 20", "scan_time": "auto"},
}


def messages(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with closing(open_recording(path)) as reader:
        for message in reader.messages():
            found.setdefault(message.connection.topic, []).append((message.log_time_ns, bytes(message.data)))
    return found


def converted(path: Path, scans: dict[str, dict[str, Any]], **options: Any) -> Any:
    return pc2scan.convert(HALL, path, scans=scans, only_scans=True, overwrite=True, **options)


def made(report: Any) -> list[Any]:
    """The entries of the outputs."""
    return [topic for topic in report.topics if topic.action == "converted"]


@pytest.mark.parametrize("jobs", [1, 3])
def test_each_output_is_as_if_it_were_alone(jobs: int, tmp_path: Path) -> None:
    together = converted(tmp_path / "all.mcap", SCANS, jobs=jobs)
    found = messages(tmp_path / "all.mcap")
    assert list(found) == list(SCANS)
    for (name, own), entry in zip(SCANS.items(), made(together), strict=True):
        (alone,) = made(converted(tmp_path / "one.mcap", {name: own}, jobs=jobs))
        assert messages(tmp_path / "one.mcap") == {name: found[name]}
        assert entry == alone
        assert entry.messages_out


def test_a_message_is_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: Counter[str] = Counter()
    decoder = CLOUDS[POINTCLOUD2]

    def counting(serialization: str) -> Any:
        decode = decoder(serialization)

        def counted(data: Any) -> Any:
            calls["decode"] += 1
            return decode(data)

        return counted

    monkeypatch.setitem(CLOUDS, POINTCLOUD2, counting)
    near = {f"/near_{n}": {**BASE, "range_min": n, "where": "intensity > 20"} for n in range(3)}
    report = converted(tmp_path / "all.mcap", {**near, "/own": BAND, "/own_near": {**BAND, "range_max": 5.0}})
    # The first cloud is looked at beforehand, for the fields of all outputs; the first few are converted and judged.
    assert calls["decode"] <= made(report)[0].messages_out + 1 + 2 * JUDGED_CLOUDS


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_is_that_of_one_output(jobs: int, tmp_path: Path) -> None:
    report = converted(tmp_path / "a.mcap", {"/lost": LOST, "/found": BAND}, jobs=jobs)
    lost, found = made(report)
    count = found.messages_out
    assert (lost.messages_in, lost.messages_out, lost.skipped) == (count, 0, count)
    assert (found.messages_in, found.skipped, found.points.total > 0) == (count, 0, True)
    assert report.exit_status == 3
    assert list(messages(tmp_path / "a.mcap")) == ["/found"]
    assert any("nowhere" in entry.reason for entry in report.skipped)
    assert {entry.targets for entry in report.skipped} == {("/lost",)}


def test_nothing_is_written_if_no_output_can_be_made(tmp_path: Path) -> None:
    with pytest.raises(TransformError, match="nothing can be converted"):
        converted(tmp_path / "a.mcap", {"/lost": LOST, "/other": {**LOST, "target_frame": "never"}})
    report = pc2scan.convert(HALL, tmp_path / "a.mcap", scans={**SCANS, "/lost": LOST}, dry_run=True)
    *others, lost = made(report)
    assert all(entry.points.used for entry in others)
    assert (lost.target, lost.points.total) == ("/lost", 0)
    assert list(tmp_path.iterdir()) == []
