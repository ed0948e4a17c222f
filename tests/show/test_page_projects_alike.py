"""The page's own projection, in a real browser, against pc2scan's: every range to the bit."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.compare.golden.case import case_folders, load_case
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from show.browser import needs_chromium
from support import GOLDEN, GOLDEN_EXACT, sampled

if TYPE_CHECKING:
    from pathlib import Path

    from show.browser import Tab

pytestmark = needs_chromium

_FORWARD = [
    (f"{root.name}/{name}", folder)
    for root in (GOLDEN, GOLDEN_EXACT)
    for name, folder in case_folders(root)
    if not name.startswith(("scan_", "reverse_"))
]


def read_scans(path: Path) -> list[LaserScan]:
    with closing(open_recording(path)) as reader:
        connections = [c for c in reader.connections if c.ros_type == LASERSCAN]
        return [decode_laserscan(m.data, m.connection.serialization) for m in reader.messages(connections)]


def _compare(tab: Tab, tmp_path: Path, source: Path, **options: Any) -> int:
    """Compare all clouds of a recording; returns how many there were."""
    pc2scan.view(source, clouds=1_000, **options).save(tmp_path / "page.html")
    tab.open(tmp_path / "page.html")
    pc2scan.convert(source, tmp_path / "scans.mcap", only_scans=True, **options)
    scans = read_scans(tmp_path / "scans.mcap")
    for number, scan in enumerate(scans):
        found: dict[str, Any] = tab.call(
            "async (n) => { await window.pc2scan.go(n); return window.pc2scan.scan(); }", number
        )
        ranges = np.array([float(text.replace("Infinity", "inf")) for text in found["ranges"]], np.float32)
        assert ranges.tobytes() == scan.ranges.tobytes() or np.array_equal(ranges, scan.ranges, equal_nan=True)
    tab.assert_quiet()
    tab.page.close()
    return len(scans)


@pytest.mark.parametrize("folder", sampled([pytest.param(folder, id=name) for name, folder in _FORWARD], 1))
def test_golden_cases(browser: Any, tmp_path: Path, folder: Path) -> None:
    case = load_case(folder)
    assert _compare(browser(), tmp_path, case.inputs[0], params_file=case.params) > 0
