"""The options of a batch's conversions: as they are typed, as keywords, and in dataset files."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import pc2scan
from pc2scan.datasets.dataset_file import DatasetEntry
from pc2scan.datasets.jobs import digest_of, request_of
from pc2scan.errors import UsageError
from pc2scan.exports.formats import FORMATS
from pc2scan.options.table import options_of
from support import ROOT
from support.batches import in_this_process, manifest_of, place
from support.command import run
from support.tables import rows


def test_formats_are_words_of_the_options() -> None:
    assert options_of("batch")["format"].value.words == options_of("export")["format"].value.words == tuple(FORMATS)


# --- What options mean ---


class Digests:
    """Digests of options as a manifest has them; nothing is converted, because the recording is empty."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "empty.bag").touch()

    def of(self, **keywords: Any) -> str:
        pc2scan.batch(self.folder / "empty.bag", self.folder / "out", **keywords)
        return self._last()

    def typed(self, *words: str) -> str:
        done = run("batch", self.folder / "empty.bag", "-o", self.folder / "out", *words)
        assert done.status == 1, done.stderr
        return self._last()

    def _last(self) -> str:
        digest: str = manifest_of(self.folder / "out")["empty.bag"]["options"]
        (self.folder / "out" / "manifest.jsonl").unlink()
        return digest


@pytest.fixture
def digests(tmp_path: Path) -> Digests:
    return Digests(tmp_path)


TABLES = Path(__file__).with_name("options.txt")


@pytest.mark.parametrize(("text", "keywords"), rows(TABLES, "typed options and keywords", text=True))
def test_typed_options_mean_what_keywords_mean(
    text: str, keywords: dict[str, Any], digests: Digests, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert digests.typed(*text.split()) == digests.of(**keywords) != digests.of()
    # For `convert`, too, where it has them.
    if not keywords.keys() & {"param", "remap", "format"}:
        called: list[Any] = []

        def converted(*args: Any, **_: Any) -> _Done:
            called.append(args)
            return _Done()

        monkeypatch.setattr("pc2scan.requests.run", converted)
        pc2scan.convert("drive.bag", tmp_path / "x", **keywords)
        ((_, _, options, output),) = called
        assert digest_of(replace(request_of(keywords), options=options)) == request_of(keywords).digest
        assert output.storage == request_of(keywords).output.storage


class _Done:
    warnings: list[str] = []  # noqa: RUF012


@pytest.mark.parametrize(("keywords", "other", "same"), rows(TABLES, "keywords that mean the same, or not"))
def test_options_that_mean_the_same_are_the_same(
    keywords: dict[str, Any], other: dict[str, Any], same: bool, digests: Digests
) -> None:
    assert (digests.of(**keywords) == digests.of(**other)) == same


def test_the_content_of_an_options_file_counts(digests: Digests, tmp_path: Path) -> None:
    params, scans = tmp_path / "params.yaml", tmp_path / "scans.yaml"
    params.write_text("min_height: 1\n")
    first = digests.of(params_file=params)
    assert first == digests.of(min_height=1)
    params.write_text("min_height: 2\n")
    assert digests.of(params_file=params) != first
    transforms = place(tmp_path, "tf.bag") / "tf.bag"
    before = digests.of(tf_from=transforms, target_frame="a")
    assert before == digests.of(tf_from=os.path.relpath(transforms), target_frame="a")
    transforms.write_bytes(transforms.read_bytes() + b"x")
    assert digests.of(tf_from=transforms, target_frame="a") != before
    # Of several outputs; another place of the same file makes no difference.
    scans.write_text("scans:\n  /low: {min_height: 0.1}\n  /high: {min_height: 1}\n")
    words: dict[str, Any] = {"max_height": 3, "param": "range_min:=0.5"}
    before = digests.of(scans=scans, **words)
    assert before == digests.typed("--scans", str(scans), "--max-height", "3", "--param", "range_min:=0.5")
    (tmp_path / "moved").mkdir()
    moved = scans.rename(tmp_path / "moved" / "scans.yaml")
    assert digests.of(scans=moved, **words) == before
    moved.write_text(moved.read_text().replace("0.1", "0.2"))
    assert digests.of(scans=moved, **words) != before
    # Of several nodes in a file, all or one.
    section = "pointcloud_to_laserscan_{}:\n  ros__parameters:\n    min_height: {}\n"
    params.write_text(section.format("low", 0.1) + section.format("high", 1.0))
    high = digests.of(params_file=params, node="pointcloud_to_laserscan_high", max_height=3.0)
    assert high == digests.of(min_height=1.0, max_height=3.0) != digests.of(params_file=params, max_height=3.0)


def test_an_unknown_export_is_named(tmp_path: Path) -> None:
    wrong: list[tuple[Any, str | None]] = [("npzz", "did you mean npz?"), ("ply", None)]
    for name, hint in wrong:
        with pytest.raises(UsageError, match=f"`format` is {name!r}, it must be one of npz") as caught:
            pc2scan.batch(place(tmp_path / name, "a.bag"), tmp_path / "out", format=name)
        assert caught.value.hint == hint


# --- Dataset files; what is wrong in one is in `transcripts/dataset_files.txt` ---


@pytest.mark.parametrize("text", ["defaults:\nrecordings:\n", "recordings: []\n"])
def test_a_dataset_file_may_have_empty_sections(text: str, digests: Digests, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text(text)
    assert digests.of(dataset=tmp_path / "dataset.yaml") == digests.of()


@pytest.mark.parametrize(("line", "keywords"), rows(TABLES, "lines of dataset files and keywords"))
def test_a_dataset_file_has_the_options_of_conversions(
    line: str, keywords: dict[str, Any], digests: Digests, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    place(tmp_path / "data", "tf.bag")
    (tmp_path / "data" / "params.yaml").write_text("beams: 77\n")
    (tmp_path / "data" / "set.yaml").write_text(f"defaults:\n  {line}\n")
    found = digests.of(dataset=tmp_path / "data" / "set.yaml")
    # Paths are relative to the file.
    monkeypatch.chdir(tmp_path / "data")
    more = {"target_frame": "a"} if "tf_from" in keywords else {}
    assert found == digests.of(**keywords, **more) != digests.of(**more)


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


def test_the_documented_dataset_file_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "datasets.md").read_text("utf-8")
    (tmp_path / "set.yaml").write_text(text.partition("```yaml\n")[2].partition("```")[0])
    (tmp_path / "robot2.yaml").write_text("beams: 90\n")
    for folder in ("robot1", "robot2"):
        (tmp_path / "in" / folder).mkdir(parents=True)
    for name in ("robot2/x_outdoor.bag", "robot1/calibration_3.mcap", "a.bag"):
        (tmp_path / "in" / name).touch()
    report = pc2scan.batch(tmp_path / "in", tmp_path / "out", dataset=tmp_path / "set.yaml")
    assert {each.key: each.outcome for each in report.outcomes}["robot1/calibration_3.mcap"] == "skipped"
    lines = manifest_of(tmp_path / "out")
    assert lines["a.bag"]["options"] != lines["robot2/x_outdoor.bag"]["options"]
