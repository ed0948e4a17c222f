"""The options of a batch's conversions: as keywords, and in dataset files."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.datasets.planning import DatasetEntry
from pc2scan.errors import UsageError
from support import ROOT
from support.batches import in_this_process, manifest_of, place
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable

TABLES = Path(__file__).with_name("options.txt")


@pytest.fixture
def digest(tmp_path: Path) -> Callable[..., str]:
    """Return the digest of options as a manifest has it; nothing is converted, because the recording is empty."""
    (tmp_path / "empty.bag").touch()

    def of(**keywords: Any) -> str:
        pc2scan.batch(tmp_path / "empty.bag", tmp_path / "out", **keywords)
        found: str = manifest_of(tmp_path / "out")["empty.bag"]["options"]
        (tmp_path / "out" / "manifest.jsonl").unlink()
        return found

    return of


@pytest.mark.parametrize(("keywords", "other", "same"), rows(TABLES, "keywords that mean the same, or not"))
def test_options_that_mean_the_same_are_the_same(
    keywords: dict[str, Any], other: dict[str, Any], same: bool, digest: Callable[..., str]
) -> None:
    assert (digest(**keywords) == digest(**other)) == same


def test_the_content_of_an_options_file_counts(digest: Callable[..., str], tmp_path: Path) -> None:
    params, scans = tmp_path / "params.yaml", tmp_path / "scans.yaml"
    params.write_text("min_height: 1\n")
    first = digest(params_file=params)
    assert first == digest(min_height=1)
    params.write_text("min_height: 2\n")
    assert digest(params_file=params) != first
    transforms = place(tmp_path, "tf.bag") / "tf.bag"
    before = digest(tf_from=transforms, target_frame="a")
    assert before == digest(tf_from=os.path.relpath(transforms), target_frame="a")
    transforms.write_bytes(transforms.read_bytes() + b"x")
    assert digest(tf_from=transforms, target_frame="a") != before
    # Another place of the same file makes no difference.
    scans.write_text("scans:\n  /low: {min_height: 0.1}\n  /high: {min_height: 1}\n")
    before = digest(scans=scans)
    (tmp_path / "moved").mkdir()
    moved = scans.rename(tmp_path / "moved" / "scans.yaml")
    assert digest(scans=moved) == before
    moved.write_text(moved.read_text().replace("0.1", "0.2"))
    assert digest(scans=moved) != before


# --- Dataset files; what is wrong in one is in `transcripts/dataset_files.txt` ---


@pytest.mark.parametrize(("line", "keywords"), rows(TABLES, "lines of dataset files and keywords"))
def test_a_dataset_file_has_the_options_of_conversions(
    line: str, keywords: dict[str, Any], digest: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    place(tmp_path / "data", "tf.bag")
    (tmp_path / "data" / "params.yaml").write_text("beams: 77\n")
    (tmp_path / "data" / "set.yaml").write_text(f"defaults:\n  {line}\n")
    found = digest(dataset=tmp_path / "data" / "set.yaml")
    # Paths are relative to the file.
    monkeypatch.chdir(tmp_path / "data")
    more = {"target_frame": "a"} if "tf_from" in keywords else {}
    assert found == digest(**keywords, **more) != digest(**more)


@pytest.mark.parametrize(("pattern", "matching", "others"), rows(TABLES, "patterns, what matches, and what does not"))
def test_patterns_match_recordings(pattern: str, matching: list[str], others: list[str]) -> None:
    entry = DatasetEntry("line 1", (pattern,))
    assert [key for key in matching if not entry.matches(key)] == []
    assert [key for key in others if entry.matches(key)] == []


def test_later_entries_override_and_the_call_overrides_all(tmp_path: Path) -> None:
    place(tmp_path / "in", "robot1/a.bag", "robot1/b.mcap", "c.mcap", "skipped.mcap")
    (tmp_path / "set.yaml").write_text(
        "defaults:\n  min_height: -1\n  beams: 360\n  max_height: 7\n  keep: [/chatter, /b]\nrecordings:\n"
        "- match: robot1/*\n  min_height: -2\n  angle_increment: 0.01\n  keep: /battery\n  topics: /points:=/front\n"
        "- match: ['*.bag', '*.db3']\n  min_height: -3\n  to: mcap\n"
        "- match: skipped.mcap\n  skip: true\n- match: nothing\n  deskew: false\n"
    )
    with in_this_process():
        report = pc2scan.batch(tmp_path / "in", tmp_path / "out", dataset=tmp_path / "set.yaml", max_height=2)
    assert report.warnings == [f"{tmp_path / 'set.yaml'}, line 17: matches no recording: nothing"]
    assert {each.key: (each.outcome, each.output) for each in report.outcomes} == {
        "c.mcap": ("converted", "c_scan.mcap"),
        "robot1/a.bag": ("converted", "robot1/a_scan.mcap"),
        "robot1/b.mcap": ("converted", "robot1/b_scan.mcap"),
        "skipped.mcap": ("skipped", ""),
    }
    lines = manifest_of(tmp_path / "out")
    reports = {key: lines[key]["report"] for key in ("robot1/a.bag", "robot1/b.mcap", "c.mcap")}
    assert {key: report["scans"][0]["params"]["min_height"] for key, report in reports.items()} == {
        "robot1/a.bag": -3.0,
        "robot1/b.mcap": -2.0,
        "c.mcap": -1.0,
    }
    # A parameter replaces the one that says the same in another way.
    first, *_ = pc2scan.scans(tmp_path / "out" / "robot1" / "a_scan.mcap", "/front")
    assert first.angle_increment == pytest.approx(0.01)
    origins = reports["robot1/a.bag"]["scans"][0]["param_origins"]
    assert origins["min_height"] == f"{tmp_path / 'set.yaml'}, line 13"
    assert "set.yaml" not in origins["max_height"]


def test_the_documented_dataset_file_is_one(digest: Callable[..., str], tmp_path: Path) -> None:
    text = (ROOT / "docs" / "datasets.md").read_text("utf-8")
    (tmp_path / "set.yaml").write_text(text.partition("```yaml\n")[2].partition("```")[0])
    (tmp_path / "robot2.yaml").write_text("beams: 90\n")
    assert digest(dataset=tmp_path / "set.yaml") != digest()


def test_a_missing_package_and_a_wrong_address_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place(tmp_path, "a.bag")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="needs distributed, which is not installed"):
        pc2scan.batch(tmp_path / "a.bag", tmp_path / "out", dask=True)
    with pytest.raises(UsageError, match="the address of a scheduler is tcp://HOST:PORT"):
        pc2scan.batch(tmp_path / "a.bag", tmp_path / "out", dask="scheduler")
    assert not (tmp_path / "out").exists()
