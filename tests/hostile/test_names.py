"""Names that a terminal would act upon, that are not text, or that another encoding cannot show: none is obeyed."""

from __future__ import annotations

import csv
import json
import os
import shlex
import shutil
import subprocess
import sys
import unicodedata
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pc2scan
from pc2scan.errors import visible
from support import sampled
from support.bounded import run_bounded
from support.builders import (
    CHATTER,
    CLOUD,
    POINTS,
    SCAN,
    T0,
    Recording,
    Stream,
    cloud,
    item,
    points_of,
    scan,
    string,
    transforms,
    write_mcap,
)
from support.command import COMMAND, environment, run
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable

#: Ends the line and forges others, clears the screen, sets the title, goes back to overwrite, turns the direction;
#: in a page, runs.
EVIL = (
    "\nsame: forged\n::error::forged\r##[error]forged ##vso[task.complete]forged\x85error: forged\u2028::error::forged"
    "\x1b[2J\x1b]0;owned\x07\b\x9b31m\x7f\u202e\u2066\u200b\ufeff</script><script>alert(1)</script>&"
)

#: What lines may not begin with, and what they may not have anywhere.
FORGED = ("same: forged", "error: forged", "::")
COMMANDS_ANYWHERE = ("##[", "##vso[")

#: Names that also forge a line, or are a formula, if a line or a cell begins with them.
CLOUDS, SCANS, TEXTS = f"same: forged/points{EVIL}", f"::error::forged/scans{EVIL}", f"/chatter{EVIL}"
LIDAR, BASE, ODOM = f"=cmd|' /C calc'!A0{EVIL}", f"error: forged{EVIL}", f"::error::forged/odom{EVIL}"
#: A name of a file cannot have a slash.
FILE = f"same: forged{EVIL}"[:60].replace("/", "_")

_STEP = 100_000_000

_POINTS = np.column_stack([points_of(1), np.arange(60, dtype=np.float32)])
_RANGES = np.linspace(1, 9, 60, dtype=np.float32)


def assert_plain(text: str) -> None:
    """No control, mark of direction or separator but the line's end."""
    found = {c for c in text if unicodedata.category(c) in {"Cc", "Cf", "Zl", "Zp", "Cs"}} - {"\n"}
    assert not found, found


def assert_harmless(text: str) -> None:
    """Plain text without a command of a CI system or a forged line."""
    assert_plain(text)
    forged = [line for line in text.split("\n") if line.lstrip().startswith(FORGED)]
    assert not forged, forged
    assert not any(command in text for command in COMMANDS_ANYWHERE)


def write(path: Path, *, height: float = 1.0) -> Path:
    """A recording in which every name is hostile: clouds, scans, texts, transforms."""
    clouds, scans, texts = Stream(CLOUDS, CLOUD, f"/lidar{EVIL}"), Stream(SCANS, SCAN), Stream(TEXTS, CHATTER.msgtype)
    frames = Stream("/tf", "tf2_msgs/msg/TFMessage")
    fixed_frames = Stream("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
    fields = ("x", "y", "z", f"f{EVIL}")
    items = []
    for n in range(4):
        at = T0 + n * _STEP
        moved = [(ODOM, BASE, at, (n * 0.1, 0.0, 0.0))]
        mounted = [(BASE, LIDAR, T0, (0.0, 0.0, height))]
        made: list[tuple[Stream, Callable[[int, int], bytes]]] = [
            (frames, lambda g, s, rows=moved: transforms(rows, g, s)),  # type: ignore[misc]
            (fixed_frames, lambda g, s, rows=mounted: transforms(rows, g, s)),  # type: ignore[misc]
            (clouds, lambda g, _, t=at: cloud(_POINTS, g, stamp_ns=t, frame_id=LIDAR, names=fields)),  # type: ignore[misc]
            (scans, lambda g, _, t=at: scan(_RANGES * height, g, stamp_ns=t, frame_id=LIDAR)),  # type: ignore[misc]
            (texts, lambda g, _: string(f"{EVIL} {height}", g)),
        ]
        items += [item(stream, at, make) for stream, make in made]
    # In a frame that has no transform.
    last = T0 + 4 * _STEP
    lost = f"lost{EVIL}"
    items.append(item(clouds, last, lambda g, _: cloud(_POINTS, g, stamp_ns=last, frame_id=lost, names=fields)))
    # Bytes are missing.
    items.append(item(clouds, last, lambda g, _: cloud(_POINTS, g, stamp_ns=last, frame_id=lost, names=fields, cut=9)))
    return write_mcap(path, Recording((frames, fixed_frames, clouds, scans, texts), tuple(items)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a hostile recording, and another one beside it."""
    made = tmp_path_factory.mktemp("hostile")
    (made / "in").mkdir()
    write(made / "in" / f"{FILE}.mcap")
    write(made / "other.mcap", height=0.5)
    return made


@pytest.fixture
def evil(folder: Path, tmp_path: Path) -> Path:
    """A copy of the recording, in a folder of its own: results may be written next to it."""
    shutil.copytree(folder / "in", tmp_path / "in")
    return tmp_path / "in" / f"{FILE}.mcap"


RUNS: dict[str, str] = dict(rows(Path(__file__).with_name("names.txt"), "commands"))


def make_cases(folder: Path, recording: Path, other: Path) -> None:
    """Golden cases: one that differs, one that cannot be read."""
    inputs = {"same: forged": str(recording), "::error::forged": f"no{EVIL}"}
    for name, path in inputs.items():
        (folder / name).mkdir(parents=True)
        (folder / name / "case.yaml").write_text(
            json.dumps({"input": path, "arguments": ["--target-frame", BASE], "exit_status": 3})
        )
    expected = folder / "same: forged" / "expected.mcap"
    assert run("convert", other, "-o", expected, "--target-frame", BASE).status in (0, 3)


@pytest.mark.parametrize("name", RUNS)
def test_nothing_that_is_printed_is_obeyed(name: str, folder: Path, evil: Path, tmp_path: Path) -> None:
    other = folder / "other.mcap"
    out = tmp_path / "out"
    out.mkdir()
    if name.startswith("golden"):
        make_cases(out / "cases", evil, other)
    places = {"INS": str(evil.parent), "IN": str(evil), "OTHER": str(other), "CLOUDS": CLOUDS, "SCANS": SCANS}
    places |= {"LIDAR": LIDAR, "BASE": BASE, "ODOM": ODOM}
    words = [
        places.get(word, word.replace("OUT", str(out)).replace("{EVIL}", EVIL)) for word in shlex.split(RUNS[name])
    ]
    done = run(*words)
    assert "Traceback" not in done.stderr
    assert done.stdout or done.stderr or name == "quiet"
    assert_harmless(done.stdout)
    assert_harmless(done.stderr)
    if "--json" in words:
        check_json(done.stdout)
    for file in out.rglob("*"):
        # Recordings and cases are not text for people.
        if file.suffix in CHECKED and file.is_file() and file.name not in ("metadata.yaml", "case.yaml"):
            CHECKED[file.suffix](file.read_text("utf-8"))


def check_page(text: str) -> None:
    assert "<script>alert" not in text
    # The page's own script is no name.
    assert_harmless(text[text.index('id="recording"') :].partition("</script>")[0])


def check_json(text: str) -> None:
    json.loads(text)
    assert text.isascii()


def check_csv(text: str) -> None:
    assert_plain(text)
    lines = list(csv.reader(text.splitlines()))
    assert len({len(line) for line in lines}) == 1
    assert len(lines) == text.count("\n")
    assert not any(cell.startswith(("=", "@", "+")) for line in lines for cell in line)


#: How files are checked, by suffix.
CHECKED: dict[str, Callable[[str], None]] = {
    ".csv": check_csv,
    ".html": check_page,
    ".json": check_json,
    ".log": assert_harmless,
    ".md": assert_harmless,
    ".tum": assert_harmless,
    ".yaml": assert_harmless,
}


def test_results_in_python_are_not_obeyed(folder: Path, evil: Path, tmp_path: Path) -> None:
    other = folder / "other.mcap"
    results: list[Any] = [
        pc2scan.convert(evil, tmp_path / "a.mcap"),
        pc2scan.info(evil),
        pc2scan.tf(evil),
        pc2scan.check(evil),
        pc2scan.diff(evil, other, all_topics=True),
        pc2scan.repair(evil, tmp_path / "sound.mcap"),
        pc2scan.batch(evil.parent, tmp_path / "batch", jobs=1),
    ]
    for result in results:
        assert_harmless(str(result))
        assert_harmless(repr(result))
    assert_harmless(results[4].text(("before", "after")))
    for stream in (pc2scan.scans(evil, topics=SCANS), pc2scan.clouds(evil)):
        assert_plain(repr(stream))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for each in stream:
                assert_plain(repr(each))
        for warning in caught:
            assert_harmless(str(warning.message))


@pytest.mark.parametrize("encoding", sampled(["ascii", "latin-1", "cp437"], 1))
def test_what_an_encoding_cannot_show_is_escaped(encoding: str, tmp_path: Path) -> None:
    stream = Stream("/läser_点", POINTS.msgtype)
    source = write_mcap(
        tmp_path / "点.mcap", Recording((stream,), (item(stream, T0, lambda g, _: cloud(points_of(1), g)),))
    )
    for command in ("info", "convert"):
        done = subprocess.run(
            [*COMMAND, command, str(source)],
            capture_output=True,
            env={**environment(), "PYTHONIOENCODING": encoding},
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert b"\\u70b9" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="file names that are no text are Linux's")
def test_a_file_name_that_is_no_text(tmp_path: Path) -> None:
    recording = Recording((POINTS,), (item(POINTS, T0, lambda g, _: cloud(points_of(1), g)),))
    source = write_mcap(tmp_path / os.fsdecode(b"a\xff.mcap"), recording)
    for command in ("info", "convert"):
        done = run_bounded(command, source)
        assert done.status == 0, done.stderr
        assert "\\udcff" in done.stdout


#: All that `visible` is about, and what it leaves alone.
_TEXTS = st.text(
    st.one_of(
        st.sampled_from("\n\r\t\x00\x1b\x7f\x85\x9b\u2028\u2029\u200b\u202e\u2066\ufeff\ud800 :#[]/"),
        st.characters(categories=["L", "N", "P", "S", "Z", "C"]),
    )
)


@given(_TEXTS)
def test_any_text_is_one_harmless_line(text: str) -> None:
    shown = visible(text, None)
    assert "\n" not in shown
    assert shown.isprintable()
    assert_harmless(shown if not shown.lstrip().startswith(("same: ", "error: ", "passed  ")) else "")
    # What is shown once stays the same, so that no text is escaped twice.
    assert visible(shown, None) == shown
    assert visible(text, 3) == (shown if len(text) <= 3 else f"{visible(text[:3], None)}... ({len(text)} chars)")
    if text.isprintable() and "[" not in text and not text.lstrip().startswith("::"):
        assert shown == text
