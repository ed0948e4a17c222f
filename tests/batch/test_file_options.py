"""The keywords of conversions: the same for Python, for the command line and for dataset files."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
import typer
from typer.testing import CliRunner

import pc2scan
from batch.datasets import HEIGHTS
from pc2scan.batch.request import request_of
from pc2scan.cli.options import typed_command
from pc2scan.errors import UsageError
from pc2scan.export.formats import FORMATS
from pc2scan.export.poses import PoseOptions
from pc2scan.options.call import Options  # noqa: TC001  # typer's function is read with its types
from pc2scan.options.moment import TimeBound
from pc2scan.options.schemas import schema_text
from pc2scan.options.table import dataset_options, options_of
from support import ROOT
from support.builders import CONTENT, write_rosbag1

if TYPE_CHECKING:
    from pathlib import Path


def test_the_schema_is_the_one_that_is_shipped() -> None:
    committed = (ROOT / "src" / "pc2scan" / "batch" / "dataset.schema.json").read_text("utf-8")
    assert committed == schema_text("dataset"), "python -m pc2scan.options.schemas dataset > dataset.schema.json"
    properties = json.loads(committed)["properties"]["defaults"]["properties"]
    assert properties.keys() == dataset_options().keys()


def typed(*arguments: str) -> dict[str, Any]:
    """The options that a command line of ``convert`` has."""
    found: list[Options] = []

    def command(sources: list[str], *, options: Options) -> None:
        assert sources == ["drive.bag"]
        found.append(options)

    app = typer.Typer(rich_markup_mode=None)
    app.command()(typed_command("convert", command))
    assert CliRunner().invoke(app, ["drive.bag", *arguments]).exit_code == 0
    return found[0].given


#: Options as they are typed, and as keywords.
TYPED: dict[str, Any] = {
    "--topic /points:=/a --topic /b": {"topics": ("/points:=/a", "/b")},
    "--keep /x --drop /y": {"keep": ("/x",), "drop": ("/y",)},
    "--keep-clouds": {"keep_clouds": True},
    "--only-scans": {"only_scans": True},
    "--start 1 --end 2": {"start": TimeBound(10**9), "end": TimeBound(2 * 10**9)},
    "--min-height 10cm --use-inf": {"min_height": "10cm", "use_inf": True},
    "--beams 360 --no-return nan": {"beams": 360, "no_return": "nan"},
    "--param min_height:=0.5": {"param": ("min_height:=0.5",)},
    "--remap scan:=/front --ros-args": {"remap": ("scan:=/front",)},
    "--preset gmapping": {"preset": "gmapping"},
    "--where ring<3 --min-height-slope 0.1": {"where": ("ring<3",), "min_height_slope": 0.1},
    "--tf-topic /robot/tf --target-frame base_link": {"tf_topics": ("/robot/tf",), "target_frame": "base_link"},
    "--source-frame lidar": {"source_frame": "lidar"},
    "--deskew --fixed-frame odom --point-time t:ns --stamp middle": {
        "deskew": True,
        "fixed_frame": "odom",
        "point_time": "t:ns",
        "stamp": "middle",
    },
    "--level --imu /imu/data": {"level": True, "imu": "/imu/data"},
    "--reverse --channel stamps --range-cutoff 50cm": {"reverse": True, "channels": ("stamps",), "range_cutoff": 0.5},
    "--on-error fail --fail-on empty --min-used 5%": {"on_error": "fail", "fail_on": "empty", "min_used": 0.05},
    "--no-verify --strict": {"verify": False, "strict": True},
    "--storage sqlite3 --compression zstd": {"storage": "sqlite3", "compression": "zstd"},
    "--to mcap --profile ros2 --ros-distro humble": {"to": "mcap", "profile": "ros2", "ros_distro": "humble"},
    "--split 60s --repeat-latched --to rosbag2": {"split": "60s", "repeat_latched": True, "to": "rosbag2"},
    "--metadata-version 9 --overwrite": {"metadata_version": 9, "overwrite": True},
    "": {},
}


@pytest.mark.parametrize("text", TYPED)
def test_typed_options_are_keywords(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keywords = typed(*text.split())
    assert {**keywords, **TYPED[text]} == keywords
    assert keywords.keys() == TYPED[text].keys()
    # They mean the same to `convert` in Python, where it has them.
    called: list[Any] = []

    def run(*args: Any, **_: Any) -> _Done:
        called.append(args)
        return _Done()

    monkeypatch.setattr("pc2scan.pipeline.run.run", run)
    if not keywords.keys() & {"param", "remap"}:
        pc2scan.convert("drive.bag", tmp_path / "x", **keywords)
        request = request_of(keywords)
        options = called[0][2]
        assert replace(request, options=options).digest() == request.digest()
        assert [scan.origins for scan in options.scans] == [scan.origins for scan in request.options.scans]
        assert called[0][3].storage == request.output.storage
        assert called[0][3].cut == request.output.cut


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
        ({"strict": True}, {}, False),
    ],
)
def test_a_digest_is_of_what_decides_the_output(keywords: dict[str, Any], other: dict[str, Any], same: bool) -> None:
    assert (request_of(keywords).digest() == request_of(other).digest()) == same


def test_repeating_goes_with_splitting() -> None:
    with pytest.raises(UsageError, match="`split`"):
        request_of({"repeat_latched": True})


def test_a_digest_sees_the_files_of_options(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("min_height: 1\n")
    first = request_of({"params_file": file})
    file.write_text("min_height: 2\n")
    assert request_of({"params_file": file}).digest() != first.digest()
    assert first.digest() == request_of({"min_height": 1}).digest()
    transforms = write_rosbag1(tmp_path / "tf.bag", CONTENT)
    before = request_of({"tf_from": transforms, "target_frame": "a"}).digest()
    transforms.write_bytes(transforms.read_bytes() + b"x")
    assert request_of({"tf_from": transforms, "target_frame": "a"}).digest() != before


def test_several_outputs_are_words(tmp_path: Path) -> None:
    file = tmp_path / "scans.yaml"
    file.write_text("scans:\n  /low: {min_height: 0.1}\n  /high: {min_height: 1}\n")
    asked = request_of(
        {"scans": str(file), "max_height": 3, "param": ("range_min:=0.5",)}, {"max_height": "--max-height"}
    )
    low, high = asked.options.scans
    assert (low.params.min_height, high.params.min_height, high.params.max_height) == (0.1, 1.0, 3.0)
    assert (low.params.range_min, low.origins["max_height"]) == (0.5, "--max-height")
    assert f"{file.name} (from `scans`)" in asked.files
    assert str(typed("--scans", str(file))["scans"]) == str(file)
    # Another place of the same file makes no difference.
    (tmp_path / "moved").mkdir()
    moved = file.rename(tmp_path / "moved" / "scans.yaml")
    again = request_of({"scans": moved, "max_height": 3, "param": "range_min:=0.5"})
    assert again.digest() == asked.digest()
    moved.write_text(moved.read_text().replace("0.1", "0.2"))
    assert request_of({"scans": moved, "max_height": 3, "range_min": 0.5}).digest() != asked.digest()
    with pytest.raises(UsageError, match="`preset` cannot be combined with `scans`"):
        request_of({"scans": moved, "preset": "gmapping"})


def test_several_nodes_of_a_file_are_several_outputs(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    section = "  ros__parameters:\n    min_height: {}\n"
    nodes = {"low": 0.1, "high": 1.0}
    file.write_text("".join(f"pointcloud_to_laserscan_{name}:\n{section.format(z)}" for name, z in nodes.items()))
    asked = request_of({"params_file": file, "max_height": 3.0})
    assert [spec.params.min_height for spec in asked.options.scans] == [0.1, 1.0]
    assert {spec.params.max_height for spec in asked.options.scans} == {3.0}
    one = request_of({"params_file": file, "node": "pointcloud_to_laserscan_high"})
    assert [(spec.name, spec.params.min_height) for spec in one.options.scans] == [("", 1.0)]
    with pytest.raises(UsageError, match="does not name a node"):
        request_of({"params_file": file, "topics": "/points"})


def test_exports_are_those_of_the_command() -> None:
    assert options_of("batch")["export"].value.words == options_of("export")["format"].value.words == tuple(FORMATS)
    asked = request_of({"export": "npz", "pose_frame": "odom", "min_height": 0})
    assert asked.export is not None
    assert (asked.export.converting, asked.export.poses.pose_frame) == (True, "odom")
    assert request_of({"export": "pcd"}).export == replace(
        asked.export, format="pcd", poses=PoseOptions(), converting=False
    )
    assert (
        asked.digest()
        != request_of({"export": "npz", "min_height": 0}).digest()
        != request_of({"min_height": 0}).digest()
    )
    for keywords, message in (
        ({"pose_frame": "odom"}, "`pose_frame` goes with `export`"),
        ({"export": "npy"}, "`export` is 'npy', it must be one of npz"),
        ({"export": "tum"}, "`export=tum` needs poses"),
        ({"export": "npz", "to": "bag", "split": "1s"}, "`to`, `split` would have no effect"),
    ):
        with pytest.raises(UsageError, match=re.escape(message)):
            request_of(keywords)


def test_what_is_no_word_is_refused() -> None:
    with pytest.raises(UsageError, match="`each` is not an option of a conversion"):
        request_of({"each": True})
    assert HEIGHTS
