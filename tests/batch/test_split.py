"""A batch whose outputs are split."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path


def test_each_output_is_a_directory_of_several_files_and_is_known_the_next_time(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("a.bag", "b.bag"):
        shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "in" / name)
    outcomes = []
    for split in ("0.2s", "0.2s", "0.1s"):
        done = pc2scan.batch(tmp_path / "in", tmp_path / "out", min_height=-0.3, split=split, to="rosbag2")
        assert done.exit_status == 0
        files = {path.name: len(list(path.glob("*.mcap"))) for path in (tmp_path / "out").iterdir() if path.is_dir()}
        outcomes.append((files, [path.stat().st_ino for path in sorted((tmp_path / "out").glob("*_scan"))]))
    assert [files for files, _ in outcomes] == [
        {"a_scan": 3, "b_scan": 3},
        {"a_scan": 3, "b_scan": 3},
        {"a_scan": 5, "b_scan": 5},
    ]
    # The second time nothing was to be done, the third time both.
    assert outcomes[0][1] == outcomes[1][1]


@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_numbered_files_are_one_result(suffix: str, tmp_path: Path) -> None:
    (tmp_path / "in" / "robot").mkdir(parents=True)
    for name in ("a.bag", "robot/b.bag"):
        shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "in" / name)
    out = tmp_path / "out"

    def again(split: str | None, **more: Any) -> tuple[int, list[str]]:
        options: dict[str, Any] = {} if split is None else {"split": split}
        done = pc2scan.batch(tmp_path / "in", out, min_height=-0.3, to=suffix, **options, **more)
        assert done.exit_status == 0, done.outcomes
        return done.unchanged, sorted(path.name for path in out.rglob(f"*.{suffix}"))

    parts = [f"{stem}_scan_{number}.{suffix}" for stem in "ab" for number in range(3)]
    assert again("0.2s") == (0, parts)
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    output = next(line["output"] for line in lines if line["key"] == "robot/b.bag")
    assert output["path"] == f"robot/b_scan_0.{suffix}"
    assert [name for name, _, _ in output["files"]] == [f"b_scan_{number}.{suffix}" for number in range(3)]
    assert output["bytes"] == sum(path.stat().st_size for path in (out / "robot").iterdir())
    pc2scan.convert(tmp_path / "in" / "a.bag", tmp_path / f"a_scan.{suffix}", split="0.2s", min_height=-0.3)
    for path in sorted(tmp_path.glob(f"a_scan_*.{suffix}")):
        assert (out / path.name).read_bytes() == path.read_bytes()

    assert again("0.2s") == (2, parts)
    # Any of the files that is missing or changed counts.
    (out / f"a_scan_1.{suffix}").unlink()
    assert again("0.2s") == (1, parts)
    with (out / "robot" / f"b_scan_2.{suffix}").open("ab") as file:
        file.write(b"x")
    assert again("0.2s") == (1, parts)
    # Fewer files replace all.
    fewer = [name for name in parts if not name.endswith(f"_2.{suffix}")]
    assert again("0.3s") == (0, fewer)
    # One file has another name, and is not taken for a part.
    whole = [f"a_scan.{suffix}", f"b_scan.{suffix}"]
    assert again(None) == (0, sorted([*fewer, *whole]))
    assert again(None) == (2, sorted([*fewer, *whole]))


def test_numbered_files_of_another_origin_stay(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path / "in" / "a.bag")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a_scan_7.bag").write_text("mine")
    done = pc2scan.batch(tmp_path / "in", tmp_path / "out", min_height=-0.3, split="0.2s")
    assert done.exit_status == 1
    assert "exists already, and was not written by this batch" in done.outcomes[0].error
    assert [path.name for path in (tmp_path / "out").glob("*.bag")] == ["a_scan_7.bag"]
    done = pc2scan.batch(tmp_path / "in", tmp_path / "out", min_height=-0.3, split="0.2s", overwrite=True)
    assert done.counts == {"converted": 1}
    # What this run does not write stays, and is named.
    assert sorted(path.name for path in (tmp_path / "out").glob("*")) == [
        *(f"a_scan_{n}.bag" for n in (0, 1, 2, 7)),
        "manifest.jsonl",
    ]
    assert (tmp_path / "out" / "a_scan_7.bag").read_text() == "mine"
    line = json.loads((tmp_path / "out" / "manifest.jsonl").read_text().splitlines()[-1])
    assert any("a_scan_7.bag: named like a part of a_scan.bag" in text for text in line["report"]["warnings"])
