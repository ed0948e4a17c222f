"""Dataset files: what they may have, which recordings an entry is for, and errors with lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.batch.choices import Choices
from pc2scan.batch.dataset_file import DatasetFile, Entry, load_dataset_file
from pc2scan.errors import UsageError
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path


def load(folder: Path, text: str) -> DatasetFile:
    path = folder / "dataset.yaml"
    path.write_text(text)
    return load_dataset_file(path)


def test_a_file_is_read(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        """
defaults: {min_height: 0.5, target_frame: base_link, use_inf: false, scan_time: auto, start: 12.5}
recordings:
  - match: [robot1/**, "*_outdoor.bag"]
    topics: /points:=/scan   # one
    drop: [/a, /b]
    params_file: params.yaml
    tf_from: [/abs/tf.bag, tf.bag]
  - match: x
    skip: true
""",
    )
    defaults, robot, skipped = found.entries
    assert defaults.keywords == {
        "min_height": 0.5,
        "target_frame": "base_link",
        "use_inf": False,
        "scan_time": "auto",
        "start": 12.5,
    }
    assert robot.keywords == {
        "topics": ("/points:=/scan",),
        "drop": ("/a", "/b"),
        "params_file": str(tmp_path / "params.yaml"),
        "tf_from": ("/abs/tf.bag", str(tmp_path / "tf.bag")),
    }
    assert (robot.line, robot.lines["drop"], skipped.skip) == (4, 6, True)


@pytest.mark.parametrize("text", ["", "# nothing\n", "defaults:\nrecordings:\n", "{}", "recordings: []\n"])
def test_a_file_may_be_empty(text: str, tmp_path: Path) -> None:
    assert load(tmp_path, text).entries == ()


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("default:\n  a: 1\n", "line 1: 'default' is not allowed in the file", "did you mean defaults?"),
        ("defaults:\n  min-height: 1\n", "line 2: 'min-height' is not allowed in defaults", "did you mean min_height?"),
        ("defaults:\n  scan: 1\n  each: 1\n", "line 2", None),
        ("defaults:\n  deskew: 1\n", "line 2: deskew is '1', it must be true or false", None),
        ("defaults:\n  min_height_slope: low\n", "line 2: min_height_slope is 'low', it must be a number", None),
        ("defaults:\n  min_height_slope: .inf\n", "must be a number", None),
        ("defaults:\n  node: [a]\n", "line 2: node is a list, it must be text", None),
        ("defaults:\n  topics: {a: b}\n", "line 2: topics is a mapping, it must be text, or a list of texts", None),
        ("defaults:\n  topics:\n", "line 2: topics is '', it must be", None),
        ("defaults:\n  stamp: midle\n", "it must be one of header, start, middle, end", "did you mean middle?"),
        ("defaults:\n  keep: /a\n  drop: /b\n  keep: /c\n", "line 4: keep is given twice; first in line 2", None),
        ("recordings:\n  a: 1\n", "line 2: recordings is not a list", "write '- match: PATTERN' for each entry"),
        ("recordings:\n- keep: /a\n", "line 2: an entry of recordings has no match", "write 'match: robot1/**' in it"),
        ("recordings:\n- match: a\n  skip: maybe\n", "line 3: skip is 'maybe', it must be true or false", None),
        ("defaults:\n  match: a\n", "line 2: 'match' is not allowed in defaults", None),
        ("- a\n", "line 1: the file is not a mapping", None),
        ("a: [\n", "line 2, column 1: not valid YAML", None),
    ],
)
def test_errors_name_the_line(text: str, message: str, hint: str | None, tmp_path: Path) -> None:
    with pytest.raises(UsageError) as raised:
        load(tmp_path, text)
    assert message in str(raised.value)
    assert str(tmp_path / "dataset.yaml") in str(raised.value)
    assert hint is None or raised.value.hint == hint


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "dataset.yml").write_text("{}")
    with pytest.raises(UsageError, match="cannot be read: No such file") as raised:
        load_dataset_file(tmp_path / "dataset.yaml")
    assert "dataset.yml" in (raised.value.hint or "")
    (tmp_path / "large.yaml").write_bytes(b"#" * 1_000_001)
    with pytest.raises(UsageError, match="more than 1,000,000 bytes"):
        load_dataset_file(tmp_path / "large.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="is not UTF-8"):
        load_dataset_file(tmp_path / "binary.yaml")


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
def test_patterns(pattern: str, matching: list[str], others: list[str]) -> None:
    entry = Entry(1, (pattern,))
    assert [key for key in matching if not entry.matches(key)] == []
    assert [key for key in others if entry.matches(key)] == []


def test_later_entries_and_the_call_override(tmp_path: Path) -> None:
    dataset = load(
        tmp_path,
        "defaults:\n  min_height: 1\n  beams: 360\n  keep: [/a, /b]\nrecordings:\n"
        "- match: robot1/*\n  min_height: 2\n  angle_increment: 0.01\n  keep: /c\n"
        "- match: '*.bag'\n  min_height: 3\n",
    )
    choices = Choices(dataset, {"max_height": 9.0}, {"max_height": "--max-height"})
    found = choices.of(["robot1/a.bag", "robot1/b.mcap", "c.mcap"])
    heights = {key: choice.request.options.scan.params.min_height for key, choice in found.items() if choice.request}
    assert heights == {"robot1/a.bag": 3.0, "robot1/b.mcap": 2.0, "c.mcap": 1.0}
    both, other = found["robot1/a.bag"].request, found["c.mcap"].request
    assert both is not None
    assert other is not None
    assert (both.options.keep, other.options.keep) == (("/c",), ("/a", "/b"))
    # A parameter replaces the one that says the same in another way.
    assert both.options.scan.params.beams == 0
    assert both.options.scan.params.angle_increment == pytest.approx(0.01)
    assert both.options.scan.origins["min_height"] == f"{tmp_path / 'dataset.yaml'}, line 11"
    assert both.options.scan.origins["max_height"] == "--max-height"
    assert choices.of(["robot1/z.bag"])["robot1/z.bag"] is found["robot1/a.bag"]
    assert choices.warnings(["c.mcap"]) == [
        f"{dataset.path}, line 6: matches no recording: robot1/*",
        f"{dataset.path}, line 10: matches no recording: *.bag",
    ]


def test_wrong_options_name_their_line(tmp_path: Path) -> None:
    texts = {
        "defaults:\n  range_min: 5\n  range_max: 1\n": "line ",
        "recordings:\n- match: x\n  min_used: 7\n": "line 3",
        "recordings:\n- match: x\n  keep: /a\n  topics: ':=/b'\n": "line 4",
        "recordings:\n- match: x\n  deskew: true\n": "line 3",
        "recordings:\n- match: x\n  static_tf:\n  - a b 1 2\n": "line 4",
    }
    for text, line in texts.items():
        with pytest.raises(UsageError) as raised:
            Choices(load(tmp_path, text), {}, {}).of(["x"])
        assert f"{tmp_path / 'dataset.yaml'}, {line}" in str(raised.value), text


def test_the_documented_file_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "datasets.md").read_text("utf-8")
    found = load(tmp_path, text.partition("```yaml\n")[2].partition("```")[0])
    assert found.matching("robot1/day1/a.bag") == (0, 1)
    assert found.matching("robot2/x_outdoor.bag") == (0, 2)
    assert found.matching("robot1/calibration_3.mcap") == (0, 1, 3)
    keywords, _, skip = found.combined((0, 1, 3))
    assert skip
    assert keywords["topics"] == ("/velodyne_points:=/scan",)
    choice = Choices(found, {}, {}).of(["robot1/a.bag"])["robot1/a.bag"]
    assert choice.request is not None
    assert choice.request.options.frames.static[0].child == "velodyne"
