"""What a batch does with each recording of a dataset: random histories against an oracle of states."""

from __future__ import annotations

import os
import random
import shutil
import warnings
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest

import pc2scan
from pc2scan.datasets.jobs import convert_one
from support import sampled
from support.batches import KEYWORDS, batch, contents, place
from support.builders import CONTENT, write_mcap, write_rosbag1, write_rosbag2

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pc2scan.datasets.jobs import Job
    from pc2scan.datasets.manifest import ManifestRecord

KEYS = ("a.bag", "b.mcap", "r/a.bag", "c")
CONTENTS = {"drive": CONTENT, "half": CONTENT.halves()[0]}
OPTIONS: tuple[dict[str, Any], ...] = ({}, {"beams": 90}, {"to": "mcap"})


#: What conversions of their own have written.
ALONE: dict[tuple[str, str, str], bytes] = {}


class World:
    """Sources, results, and the state of each.

    A recording is kept if its source, its options and its result are as recorded. Else it is converted. A file that is
    in its place is replaced with --overwrite, or if it is as a run left it, or unfinished. Otherwise it stays, and the
    recording has failed.

    Attributes
    ----------
    sources
        By key, what is in it ("" for an empty file), and when it was written.
    recorded
        By key, the source, the options and the result of the last conversion, if it did not fail.
    is_ours
        By name of a file that is there: whether it is as a run left it.
    unfinished
        Files that a killed run has begun.
    """

    def __init__(self, root: Path, seed: int) -> None:
        self.root, self.out, self.random = root, root / "out", random.Random(seed)
        self.now = 0
        self.sources: dict[str, tuple[str, int]] = {}
        self.recorded: dict[str, tuple[Any, ...]] = {}
        self.is_ours: dict[str, bool] = {}
        self.unfinished: set[str] = set()
        for key in KEYS[::2]:
            self.make(key, "drive")

    def make(self, key: str, content: str) -> None:
        """Write a source anew, at a time of its own."""
        path = self.root / "in" / key
        remove(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        write = write_rosbag1 if path.suffix == ".bag" else write_mcap if path.suffix else write_rosbag2
        if content:
            write(path, CONTENTS[content])
        else:
            path.touch()
        self.sources[key] = content, self.touch(path)

    def touch(self, path: Path) -> int:
        self.now += 1
        for file in path.iterdir() if path.is_dir() else [path]:
            os.utime(file, ns=(1, self.now))
        return self.now

    def user_acts(self) -> None:
        choose = self.random.choice
        output, act = choose([*self.is_ours, ""]), choose(("make", "make", "empty", "edit", "remove", "foreign"))
        if act == "make":
            self.make(choose(KEYS), choose([*CONTENTS]))
        elif act == "empty":
            self.make(choose(KEYS[:3]), "")
        elif act == "edit" and output:
            self.touch(self.out / output)
            self.is_ours[output] = False
        elif act == "remove" and output:
            remove(self.out / output)
            del self.is_ours[output]
        elif act == "foreign" and (output := name_of(choose(KEYS[:3]), choose(OPTIONS))) not in self.is_ours:
            (self.out / output).parent.mkdir(parents=True, exist_ok=True)
            (self.out / output).write_text("mine")
            self.is_ours[output] = False

    def expected(self, key: str, options: dict[str, Any], *, again: bool, overwrite: bool) -> str:
        output = name_of(key, options)
        if not self.sources[key][0]:
            return "refuse"
        is_ours = self.is_ours.get(output)
        if self.recorded.get(key) == (self.sources[key], digest_of(options), output) and is_ours and not again:
            return "keep"
        return "refuse" if is_ours is False and output not in self.unfinished and not overwrite else "convert"

    def run(self) -> None:
        """Run a batch, or let it be killed behind its first conversion, and hold it to what is expected."""
        options = self.random.choice((*OPTIONS, {}, {}))
        how: dict[str, Any] = {"again": self.random.random() < 0.1, "overwrite": self.random.random() < 0.3}
        kind = self.random.choice(("run", "run", "run", "dry run", "killed"))
        expected = {key: self.expected(key, options, **how) for key in sorted(self.sources)}
        before = contents(self.out)
        begun: list[str] = []

        def killed(jobs: Any, **_: object) -> Iterator[ManifestRecord]:
            begun.append(jobs[0].key)
            convert_one(jobs[0])
            raise KeyboardInterrupt
            yield

        if kind == "killed" and "convert" in expected.values():
            with patch("pc2scan.datasets.batch.run_jobs", killed), pytest.raises(KeyboardInterrupt):
                pc2scan.batch(self.root / "in", self.out, **{**KEYWORDS, **options}, **how)
            converted = begun
        else:
            report = batch(self.root / "in", self.out, **options, **how, dry_run=kind == "dry run")
            assert {each.key: each.action for each in report.outcomes} == expected
            if kind == "dry run":
                assert contents(self.out) == before
                return
            assert {each.key for each in report.outcomes if each.outcome == "failed"} == {
                key for key, action in expected.items() if action == "refuse"
            }
            converted = [key for key, action in expected.items() if action == "convert"]
        outputs = {name_of(key, options): key for key in converted}
        after = contents(self.out)
        for name, data in before.items():
            output = name if name in self.is_ours else name.partition("/")[0]
            assert output not in self.is_ours or output in outputs or after[name] == data
        for output, key in outputs.items():
            self.is_ours[output] = not begun
            if not begun:
                self.recorded[key] = self.sources[key], digest_of(options), output
        self.unfinished = (self.unfinished - outputs.keys()).union(outputs if begun else ()) & self.is_ours.keys()
        for key, action in expected.items():
            if action == "refuse":
                self.recorded.pop(key, None)
            elif action == "keep" or not begun:
                assert bytes_of(self.out / name_of(key, options)) == self.alone(key, options)

    def alone(self, key: str, options: dict[str, Any]) -> bytes:
        """What a conversion of its own writes of a recording."""
        case = self.sources[key][0], key.partition(".")[2], str(options)
        if case not in ALONE:
            folder = self.root / f"alone{len(ALONE)}"
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                pc2scan.convert(self.root / "in" / key, f"{folder}/", **KEYWORDS, **options)
            ALONE[case] = bytes_of(folder)
        return ALONE[case]


def remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def digest_of(options: dict[str, Any]) -> dict[str, Any]:
    """What of the options decides the content of a result; its name has its own rule."""
    return {name: value for name, value in options.items() if name != "to"}


def name_of(key: str, options: dict[str, Any]) -> str:
    stem, _, suffix = key.partition(".")
    to = options.get("to", suffix)
    return f"{stem}_scan{'.' if to else ''}{to}"


def bytes_of(path: Path) -> bytes:
    """The content of a file, or of all files in a folder."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    return b"".join(file.read_bytes() for file in files)


@pytest.mark.parametrize("seed", sampled(range(8), 4))
def test_a_run_does_what_is_missing_changed_or_failed(seed: int, tmp_path: Path) -> None:
    world = World(tmp_path, seed)
    for _ in range(8):
        for _ in range(world.random.choice((0, 1, 2, 4))):
            world.user_acts()
        world.run()


def test_a_result_that_is_edited_between_plan_and_turn_stays(tmp_path: Path) -> None:
    source, result = place(tmp_path / "in", "a.bag"), tmp_path / "out" / "a_scan.bag"
    batch(source, tmp_path / "out")

    def edit_and_convert(job: Job) -> ManifestRecord:
        result.write_bytes(b"edited")
        return convert_one(job)

    with patch("support.batches.convert_one", edit_and_convert):
        (failed,) = batch(source, tmp_path / "out", beams=90).outcomes
        assert (failed.outcome, result.read_bytes()) == ("failed", b"edited")
        assert "was edited since the batch began" in failed.error
        (done,) = batch(source, tmp_path / "out", beams=90, overwrite=True).outcomes
    assert done.outcome == "converted"
