"""The options of a batch's conversions: as they are typed, as keywords, and in dataset files."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.batch.dataset_file import DatasetEntry
from pc2scan.batch.request import request_of
from pc2scan.errors import UsageError
from pc2scan.export.formats import FORMATS
from pc2scan.options.schemas import schema_text
from pc2scan.options.table import dataset_options, options_of
from support import ROOT
from support.batches import in_this_process, manifest_of, place
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path


def test_the_schema_of_dataset_files_is_that_of_the_options() -> None:
    committed = (ROOT / "src" / "pc2scan" / "batch" / "dataset.schema.json").read_text("utf-8")
    assert committed == schema_text("dataset"), "python -m pc2scan.options.schemas dataset > dataset.schema.json"
    properties = json.loads(committed)["properties"]["defaults"]["properties"]
    assert properties.keys() == dataset_options().keys()
    assert options_of("batch")["export"].value.words == options_of("export")["format"].value.words == tuple(FORMATS)


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


#: Options as they are typed, and as keywords.
TYPED: dict[str, Any] = {
    "--topic /points:=/a --topic /b": {"topics": ("/points:=/a", "/b")},
    "--keep /x --drop /y": {"keep": ("/x",), "drop": ("/y",)},
    "--keep-clouds": {"keep_clouds": True},
    "--only-scans": {"only_scans": True},
    "--start 1 --end 2": {"start": "1", "end": "2"},
    "--min-height 10cm --use-inf": {"min_height": "10cm", "use_inf": True},
    "--beams 360 --no-return nan": {"beams": 360, "no_return": "nan"},
    "--param min_height:=0.5": {"param": ("min_height:=0.5",)},
    "--remap scan:=/front --ros-args": {"remap": ("scan:=/front",)},
    "--preset gmapping": {"preset": "gmapping"},
    "--where ring<3 --min-height-slope 0.1": {"where": ("ring<3",), "min_height_slope": 0.1},
    "--tf-topic /robot/tf --target-frame base_link": {"tf_topics": ("/robot/tf",), "target_frame": "base_link"},
    "--source-frame lidar": {"source_frame": "lidar"},
    "--deskew --fixed-frame odom": {"deskew": True, "fixed_frame": "odom"},
    "--deskew --fixed-frame odom --point-time t:ns": {"deskew": True, "fixed_frame": "odom", "point_time": "t:ns"},
    "--deskew --fixed-frame odom --stamp middle": {"deskew": True, "fixed_frame": "odom", "stamp": "middle"},
    "--level --imu /imu/data": {"level": True, "imu": "/imu/data"},
    "--reverse --channel stamps --range-cutoff 50cm": {"reverse": True, "channels": ("stamps",), "range_cutoff": 0.5},
    "--on-error fail --fail-on empty --min-used 5%": {"on_error": "fail", "fail_on": "empty", "min_used": 0.05},
    "--no-verify": {"verify": False},
    "--strict": {"strict": True},
    "--storage sqlite3 --compression zstd --to rosbag2": {"storage": "sqlite3", "compression": "zstd", "to": "rosbag2"},
    "--to mcap --profile ros1 --ros-distro humble": {"to": "mcap", "profile": "ros1", "ros_distro": "humble"},
    "--split 60s --repeat-latched --to rosbag2": {"split": "60s", "repeat_latched": True, "to": "rosbag2"},
    "--metadata-version 9": {"metadata_version": 9},
    "--export npz --odom-topic /odom": {"export": "npz", "odom_topic": "/odom"},
    "--export npz --pose-frame map --base-frame base": {"export": "npz", "pose_frame": "map", "base_frame": "base"},
}


@pytest.mark.parametrize("text", TYPED)
def test_typed_options_mean_what_keywords_mean(
    text: str, digests: Digests, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keywords = TYPED[text]
    assert digests.typed(*text.split()) == digests.of(**keywords) != digests.of()
    # For `convert`, too, where it has them.
    if not keywords.keys() & {"param", "remap", "export"}:
        called: list[Any] = []

        def converted(*args: Any, **_: Any) -> _Done:
            called.append(args)
            return _Done()

        monkeypatch.setattr("pc2scan.pipeline.run.run", converted)
        pc2scan.convert("drive.bag", tmp_path / "x", **keywords)
        ((_, _, options, output),) = called
        assert replace(request_of(keywords), options=options).digest() == request_of(keywords).digest()
        assert (output.storage, output.cut) == (request_of(keywords).output.storage, request_of(keywords).output.cut)


class _Done:
    warnings: list[str] = []  # noqa: RUF012


@pytest.mark.parametrize(
    ("keywords", "other", "same"),
    [
        ({"min_height": 1}, {"min_height": 1.0}, True),
        ({"min_height": 1}, {"param": "min_height:=1"}, True),
        ({"min_height": 1}, {"min_height": "100cm"}, True),
        ({"min_height": 1}, {}, False),
        ({"queue_size": 3}, {}, True),
        ({"overwrite": True}, {}, True),
        ({"topics": "/a:=/b"}, {"topics": ["/a:=/b"]}, True),
        ({"where": "ring < 3"}, {"where": "ring < 4"}, False),
        ({"exclude_box": "a 0 1 0 1 0 1"}, {"exclude_box": "a 0 1 0 1 0 2"}, False),
        ({"static_tf": "a b 0 0 0 0 0 0"}, {"static_tf": "a b 0 0 0 0 0 0.1"}, False),
        ({"start": 1}, {"start": "1.0"}, True),
        ({"to": "mcap", "compression": "none"}, {"to": "mcap"}, False),
        ({"split": "60s", "to": "rosbag2"}, {"split": "1min", "to": "rosbag2"}, True),
        ({"split": "60s", "to": "rosbag2"}, {"split": "61s", "to": "rosbag2"}, False),
        ({"split": "60s", "to": "rosbag2"}, {"split": "60s", "to": "rosbag2", "repeat_latched": True}, False),
        ({"export": "npz"}, {}, False),
        ({"export": "npz"}, {"export": "npz", "min_height": 0}, False),
        ({"export": "npz"}, {"export": "npz", "pose_frame": "odom"}, False),
    ],
)
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
    for name, hint in (("npzz", "did you mean npz?"), ("ply", None)):
        with pytest.raises(UsageError, match=f"`export` is {name!r}, it must be one of npz") as caught:
            pc2scan.batch(place(tmp_path / name, "a.bag"), tmp_path / "out", export=name)
        assert caught.value.hint == hint


# --- Dataset files; what is wrong in one is in `transcripts/dataset_files.txt` ---


@pytest.mark.parametrize("text", ["", "# nothing\n", "defaults:\nrecordings:\n", "{}", "recordings: []\n"])
def test_a_dataset_file_may_be_empty(text: str, digests: Digests, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text(text)
    assert digests.of(dataset=tmp_path / "dataset.yaml") == digests.of()


@pytest.mark.parametrize(
    ("line", "keywords"),
    [
        ("min_height: 0.5", {"min_height": 0.5}),
        ("use_inf: false", {"use_inf": False}),
        ("scan_time: auto", {"scan_time": "auto"}),
        ("start: 12.5", {"start": 12.5}),
        ("topics: /points:=/scan   # one", {"topics": ("/points:=/scan",)}),
        ("drop: [/a, /b]", {"drop": ("/a", "/b")}),
        ("params_file: params.yaml", {"beams": 77}),
        ("{tf_from: [/abs/tf.bag, tf.bag], target_frame: a}", {"tf_from": ["/abs/tf.bag", "tf.bag"]}),
    ],
)
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


@pytest.mark.parametrize(
    ("pattern", "matching", "others"),
    [
        ("a.bag", ["a.bag", "robot/a.bag", "a.bag/inner"], ["ba.bag", "a.bagx", "axbag"]),
        ("*.bag", ["a.bag", "robot/day/b.bag"], ["a.mcap"]),
        ("robot1", ["robot1/a.bag", "x/robot1/a.bag"], ["robot10/a.bag"]),
        ("robot1/", ["robot1/a.bag"], ["robot10/a.bag"]),
        ("robot1/**", ["robot1/a.bag", "robot1/day/a.bag"], ["x/robot1/a.bag"]),
        ("robot1/*", ["robot1/a.bag", "robot1/day/a.bag"], ["robot2/a.bag"]),
        ("robot?/[ab].bag", ["robot1/a.bag"], ["robot1/c.bag", "robot/a.bag"]),
        ("robot[!1]/*", ["robot2/a"], ["robot1/a"]),
        ("**/day1/*.bag", ["day1/a.bag", "x/y/day1/a.bag"], ["day2/a.bag"]),
        ("./a/b.bag", ["a/b.bag"], ["b.bag"]),
        ("a+(b).bag", ["a+(b).bag"], ["aab.bag"]),
    ],
)
def test_patterns_match_recordings(pattern: str, matching: list[str], others: list[str]) -> None:
    entry = DatasetEntry(1, (pattern,))
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
