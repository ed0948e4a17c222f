"""What `pc2scan.check` finds in scans: a table of recordings, each with all its findings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from support.scan_recordings import GOOD, START, STEP, write
from support.tables import rows

if TYPE_CHECKING:
    from pc2scan.messages.laserscan import LaserScan

TABLE = Path(__file__).with_name("findings.txt")


def scans(changes: dict[str, Any], steps: tuple[float, ...], odd: dict[str, Any], far: float) -> list[LaserScan]:
    arrays = {"ranges", "intensities"}
    pattern, other = (
        {name: np.array(value, np.float32) if name in arrays else value for name, value in own.items()}
        for own in (changes, changes | odd)
    )
    stamps = [START + round(step * STEP + far * 1e9) for step in steps]
    own = [pattern] * (len(stamps) - 1) + [other]
    stamped: list[dict[str, Any]] = [
        {"stamp_ns": stamp_ns, **each} for stamp_ns, each in zip(stamps, own, strict=False)
    ]
    return [replace(GOOD, **each) for each in stamped]


@pytest.mark.parametrize(("changes", "how", "asked", "findings", "texts"), rows(TABLE, "findings"))
def test_all_findings_and_no_others(
    changes: dict[str, Any],
    how: dict[str, Any],
    asked: dict[str, Any],
    findings: dict[str, str],
    texts: list[str],
    tmp_path: Path,
) -> None:
    content = scans(changes, how.get("steps", range(how.get("scans", 3))), how.get("odd", {}), how.get("far", 0))
    recorded = {name: value for name, value in how.items() if name in ("tree", "static", "delay")}
    found = pc2scan.check(write(tmp_path / "a.mcap", *content, **recorded), **asked)
    (topic,) = found.topics
    assert {each.kind: each.level[0] for each in topic.findings} == findings
    text = str(found)
    assert [each for each in texts if each not in text] == []
    assert found.exit_status == text.splitlines()[-1].startswith("not ok")
    # What is no number is no cure.
    assert not [each for each in topic.consumers if "nan" in each.verdict.cure or "inf," in each.verdict.cure]
    json.dumps(found.as_dict(), allow_nan=False)
