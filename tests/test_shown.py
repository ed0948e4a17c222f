"""Results as people see them in Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pc2scan
from pc2scan.messages.laserscan import encode_laserscan
from support import HALL, ROOT
from support.builders import SCAN, Item, Recording, Stream, write_mcap
from support.scan_recordings import scans

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def results(folder: Path) -> dict[str, tuple[Any, str]]:
    """A result of each kind, and a line that it shows."""
    report = pc2scan.convert(HALL, folder / "scans.mcap", preset="nav2", min_height=-0.3)
    return {
        "convert": (report, "/points /scan 5 5 - converted"),
        "repair": (pc2scan.repair(HALL, folder / "sound.bag"), "/points /points 5 5 - passed"),
        "info": (pc2scan.info(HALL), "/points sensor_msgs/msg/PointCloud2 5 9.88 1"),
        "check": (pc2scan.check(folder / "scans.mcap"), "nav2 accepted"),
        "diff": (pc2scan.diff(HALL, HALL), "same: 1 topic, 5 messages"),
        "tf": (pc2scan.tf(HALL), "lidar base_link static 1"),
        "golden": (pc2scan.golden(ROOT / "fixtures" / "golden", "default"), "passed default"),
    }


def test_results_are_shown_as_text(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name, (result, line) in results(tmp_path).items():
        # As in a notebook.
        text = repr(result)
        assert any(" ".join(shown.split()).startswith(line) for shown in text.splitlines()), (name, text)
    # Asking is silent.
    assert capfd.readouterr() == ("", "")


def test_what_went_wrong_is_shown(tmp_path: Path) -> None:
    data = HALL.with_suffix(".mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 3 // 4])
    report = pc2scan.convert(cut, tmp_path / "out.bag")
    for result in (report, pc2scan.info(cut), pc2scan.tf(cut)):
        assert "damaged: " in str(result)
    assert report.exit_status == 3
    assert "warning: /scan: " in str(report)
    stream = Stream("/scan", SCAN)
    items = [Item(stream, scan.stamp_ns, {2: encode_laserscan(scan, "cdr")}) for scan in scans(3)]
    items[1] = Item(stream, items[1].log_time_ns, {2: items[1].data[2][:40]})
    broken = write_mcap(tmp_path / "broken.mcap", Recording((stream,), tuple(items)))
    text = str(pc2scan.convert(broken, tmp_path / "clouds.mcap", reverse=True))
    assert "skipped: /scan, log time 1700000000.100000000 (2023-11-14 22:13:20 UTC): " in text
