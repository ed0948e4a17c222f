"""What a batch does with each recording of a dataset, and why: random histories against a model of the manifest.

The model keeps the lines that runs have written, and says from them, from the sources and from the results what the
next run does. Whatever happens, what is kept is what a conversion of today writes.
"""

from __future__ import annotations

import json
import os
import random
import warnings
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest

import pc2scan
from pc2scan.datasets.jobs import Event, convert_one
from pc2scan.errors import OutputError
from pc2scan.text import size
from support import sampled
from support.batches import KEYWORDS, batch, manifest_of, place
from support.builders import CHATTER, CONTENT, Recording, write_mcap, write_rosbag1, write_rosbag2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from pc2scan.datasets.summary import Outcome

#: Contents of a source by name; none of them has the length of another, but for those of one length.
CONTENTS = {
    "drive": CONTENT,
    "half": CONTENT.halves()[0],
    "no clouds": Recording((CHATTER,), tuple(CONTENT.of(CHATTER.topic))),
}
OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"beams": 90},
    {"to": "mcap"},
)

#: Name and size and time of each file, as `os.stat` has them.
Files = tuple[tuple[str, int, int], ...]


@dataclass
class Line:
    """A line of the manifest, as far as later runs read it."""

    options: int
    source: Files
    outcome: str
    error: str = ""
    #: Of an error about a result, its path.
    place: str = ""
    output: str = ""
    left: Files = ()
    is_older: bool = False


@dataclass
class World:
    root: Path
    random: random.Random
    lines: list[tuple[str, Line]] = field(default_factory=list)
    now_ns: int = 1_700_000_000_000_000_000

    @property
    def out(self) -> Path:
        return self.root / "out"

    def keys(self) -> list[str]:
        return sorted(name for name in ("a.bag", "b.mcap", "r/a.bag", "c") if (self.root / "in" / name).exists())

    def make(self, key: str, content: str) -> None:
        """Write a source anew, at a time of its own."""
        path = self.root / "in" / key
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            for file in path.iterdir():
                file.unlink()
            path.rmdir()
        write = write_rosbag1 if path.suffix == ".bag" else write_mcap if path.suffix else write_rosbag2
        path.unlink(missing_ok=True)
        write(path, CONTENTS[content])
        self.touch(path)

    def touch(self, path: Path) -> None:
        self.now_ns += 1
        for file in [*path.iterdir()] if path.is_dir() else [path]:
            os.utime(file, ns=(1, self.now_ns))

    def user_acts(self) -> None:
        choose = self.random.choice
        key = choose(("a.bag", "b.mcap", "r/a.bag", "c"))
        path, written = self.root / "in" / key, sorted(self.out.rglob("*_scan*.*"))
        match choose(
            (
                "make",
                "make",
                "touch",
                "break",
                "remove",
                "edit",
                "shorten",
                "foreign",
                "tear",
                "older",
                "died",
            )
        ):
            case "make":
                self.make(key, choose(tuple(CONTENTS)))
            case "touch" if path.exists():
                self.touch(path)
            case "break" if path.is_file():
                path.write_bytes(b"")
                self.touch(path)
            case "remove" if written:
                choose(written).unlink()
            case "edit" if written:
                self.touch(choose(written))
            case "shorten" if written:
                changed = choose(written)
                changed.write_bytes(changed.read_bytes()[:-1])
            case "foreign":
                foreign = self.out / choose(("a_scan.bag", "a_scan.mcap", "b_scan.mcap", "r/a_scan.bag"))
                if not foreign.exists():
                    foreign.parent.mkdir(parents=True, exist_ok=True)
                    foreign.write_text("mine")
            case "older" if self.lines:
                self.rewrite({"pc2scan": "0.0.1"}, is_older=True)
            case "died" if self.lines:
                # As if the process had died that converted it, after its file had its name.
                output = self.lines[-1][1].output or "none"
                died = {"outcome": "died", "output": {"path": output, "files": []}, "error": None, "report": None}
                self.rewrite(died, outcome="died", error="", left=(), output=output)
            case "tear" if self.lines:
                manifest = self.out / "manifest.jsonl"
                data = complete(manifest)
                last = len(data) - data[:-1].rfind(b"\n") - 1
                manifest.write_bytes(data[: -self.random.randrange(1, last)])
                self.lines.pop()

    def rewrite(self, values: dict[str, Any], **known: Any) -> None:
        """Change the last line of the manifest, and what is known of it."""
        *lines, last = complete(self.out / "manifest.jsonl").splitlines()
        lines.append(json.dumps(json.loads(last) | values).encode())
        (self.out / "manifest.jsonl").write_bytes(b"".join(line + b"\n" for line in lines))
        key, line = self.lines.pop()
        self.lines.append((key, replace(line, **known)))

    # --- The model ---

    def expected(self, key: str, options: int, *, again: bool, overwrite: bool) -> tuple[str, str]:
        """The action, and why; of what is refused the error."""
        path = self.root / "in" / key
        if path.is_file() and not path.stat().st_size:
            return "refuse", "is empty"
        output = name_of(key, options)
        before = dict(self.lines).get(key)
        written = {line.output: line.left for _, line in self.lines if line.left}
        there = files_in(self.out / output)
        why = "asked for" if again else self.why(before, options, path, output, there)
        if why and there and not overwrite:
            # It is as a line has left it; or what is there is not known, since the process died that wrote it.
            died = {line.output for line in dict(self.lines).values() if line.outcome == "died"}
            if output not in died and there != written.get(output):
                if output not in written:
                    return "refuse", "exists already, and was not written by this batch"
                names = sorted({name for name, _, _ in {*there} - {*written[output]}} - {output.rpartition("/")[2]})
                return "refuse", "was edited since" + (f": {', '.join(names)}" if names else "")
        return ("convert", why) if why else ("keep", "unchanged")

    def why(self, line: Line | None, options: int, path: Path, output: str, there: Files) -> str:
        if line is None:
            return "new"
        if line.is_older:
            return "converted by pc2scan 0.0.1"
        if digest_of(line.options) != digest_of(options):
            return "other options"
        now = files_in(path)
        if [each[1] for each in now] != [each[1] for each in line.source]:
            return f"the source was changed: it has {total(now)}, it had {total(line.source)}"
        if now != line.source:
            return "the source was changed: another time of modification"
        if line.outcome == "no clouds":
            return ""
        if not line.left:
            return f"{line.outcome} before" + (f": {line.error}" if line.error else "")
        if line.output != output:
            return f"written to {line.output} before"
        if not there:
            return "its output is missing"
        if there != line.left:
            return f"its output was changed: it has {total(there)}, it was written with {total(line.left)}"
        return ""

    def run(self) -> list[tuple[str, Line]]:
        """Run a batch; return the lines of the results that are there now."""
        chance = self.random.random
        options = self.random.choice((0, 0, 0, 0, 1, 2))
        how = {"again": chance() < 0.1, "overwrite": chance() < 0.3}
        dry_run = chance() < 0.2
        expected = {key: self.expected(key, options, **how) for key in self.keys()}
        before = files_in(self.out)
        report = batch(self.root / "in", self.out, **OPTIONS[options], **how, dry_run=dry_run)
        found = {
            each.key: (each.action, each.error if each.action == "refuse" else each.why) for each in report.outcomes
        }
        assert found == expected
        if dry_run:
            assert files_in(self.out) == before
            return []
        # First what is refused; then the largest recordings.
        for each in sorted(
            report.outcomes, key=lambda each: -each.bytes_read if each.action == "convert" else -(1 << 40)
        ):
            self.note(each, options, set(before))
        assert complete(self.out / "manifest.jsonl").count(b"\n") == len(self.lines)
        for key, line in manifest_of(self.out).items():
            output, known = line["output"] or {"path": "", "files": [], "bytes": 0}, dict(self.lines)[key]
            assert line["outcome"] == known.outcome
            assert output["path"] == known.output
            assert output["files"] == [list(file) for file in known.left]
            assert output["bytes"] == sum(size for _, size, _ in known.left)
        return [(key, line) for key, line in dict(self.lines).items() if key in found and line.left]

    def note(self, done: Outcome, options: int, before: set[tuple[str, int, int]]) -> None:
        """Add the line of a recording; of the files of its result those that were not there ``before``."""
        key, outcome, error = done.key, done.outcome, done.error
        if done.action == "keep":
            return
        path, last = self.root / "in" / key, dict(self.lines).get(key)
        output = name_of(key, options)
        place = output if done.action == "refuse" and error != "is empty" else ""
        line = Line(options, files_in(path), outcome, error, place)
        if done.action == "convert":
            line.output = output
            found = files_in(self.out / output) if outcome == "converted" else ()
            line.left = tuple(each for each in found if each not in before)
        else:
            line.output = last.output if last is not None else ""
            said = last is not None and (
                *(last.outcome, last.error, last.place, last.source),
                *(digest_of(last.options), last.is_older),
            )
            if said == (outcome, error, place, line.source, digest_of(options), False):
                return
        self.lines.append((key, line))


def complete(manifest: Path) -> bytes:
    """The lines of a manifest that have their end."""
    data = manifest.read_bytes()
    return data[: data.rfind(b"\n") + 1]


def digest_of(options: int) -> dict[str, Any]:
    """What of the options decides the content of a result; its name has its own rule."""
    return {name: value for name, value in OPTIONS[options].items() if name != "to"}


def name_of(key: str, options: int) -> str:
    stem, _, suffix = key.partition(".")
    to = OPTIONS[options].get("to", suffix)
    return f"{stem}_scan{'.' if to else ''}{to}"


def files_in(path: Path) -> Files:
    """Everything in a folder, or a file; nothing if there is none."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    return tuple((file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files)


def total(files: Files) -> str:
    return size(sum(each[1] for each in files))


def bytes_of(path: Path) -> bytes:
    return b"".join(file.read_bytes() for file in ([path] if path.is_file() else sorted(path.iterdir())))


def results_in(output: Path, files: Files) -> list[bytes]:
    """The content of a result: of one file, or of the files of a folder."""
    folder = output if output.is_dir() else output.parent
    return [(folder / name).read_bytes() for name, *_ in files]


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, int], list[bytes]]:
    """Returns what a conversion of its own writes, by content and options."""
    found: dict[tuple[bytes, str, int], list[bytes]] = {}

    def of(source: Path, options: int) -> list[bytes]:
        key = bytes_of(source), source.suffix, options
        if key not in found:
            folder = tmp_path_factory.mktemp("alone")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                pc2scan.convert(source, f"{folder}/", **KEYWORDS, **OPTIONS[options])
            found[key] = [file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()]
        return found[key]

    return of


def test_a_result_whose_beginning_nobody_heard_of_is_known(tmp_path: Path) -> None:
    """The news from a cluster are late: the interruption comes first."""
    drives, out = place(tmp_path / "drives", "a.bag", "b.bag"), tmp_path / "out"

    def execute(jobs: Any, **_: object) -> Iterator[Any]:
        assert convert_one(jobs[0]).error is None
        raise KeyboardInterrupt
        yield

    with patch("pc2scan.datasets.run.run_jobs", execute), pytest.raises(KeyboardInterrupt):
        pc2scan.batch(drives, out, **KEYWORDS)
    assert manifest_of(out) == {}
    assert len(list(out.glob("*_scan.bag"))) == 1
    report = batch(drives, out)
    assert (report.exit_status, {each.outcome for each in report.outcomes}) == (0, {"converted"})


def test_a_result_whose_line_cannot_be_written_is_known(tmp_path: Path) -> None:
    drives, out = place(tmp_path / "drives", "a.bag"), tmp_path / "out"

    def execute(jobs: Any, **_: object) -> Iterator[Any]:
        yield Event("begun", jobs[0].key)
        done = convert_one(jobs[0])
        (out / "manifest.jsonl").mkdir()
        yield Event("done", jobs[0].key, done)

    with (
        patch("pc2scan.datasets.run.run_jobs", execute),
        pytest.raises(OutputError, match="the manifest cannot be written"),
    ):
        pc2scan.batch(drives, out, **KEYWORDS)
    (out / "manifest.jsonl").rmdir()
    assert (out / "a_scan.bag").exists()
    assert [each.why for each in batch(drives, out).outcomes] == ["interrupted before"]


@pytest.mark.parametrize("seed", sampled(range(40), 10))
def test_a_run_does_what_is_missing_changed_or_failed(
    seed: int, tmp_path: Path, converted: Callable[[Path, int], list[bytes]]
) -> None:
    world = World(tmp_path, random.Random(seed))
    (tmp_path / "in").mkdir()
    for key in ("a.bag", "r/a.bag"):
        world.make(key, "drive")
    for _ in range(8):
        for _ in range(world.random.choice((0, 1, 2, 4))):
            world.user_acts()
        for key, line in world.run():
            source = world.root / "in" / key
            assert results_in(world.out / line.output, line.left) == converted(source, line.options)
