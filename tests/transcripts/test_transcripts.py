"""The command as people type it: tests that are texts, with what is typed, how it ends, and what it says.

A file of transcripts is about one subject; each of its cases is a heading, commands and what is expected of them::

    == a name that nearly matches
    $ touch drive.bag
    $ pc2scan info drvie.bag
    ? 2
    error: drvie.bag: does not exist
    hint: did you mean drive.bag?

Each case runs in an empty folder; a fixture that it names (``hall.bag``, ``hall.mcap``, ``hall``, a golden case such as
``tf_static``, or one of `fixtures/reports` and `tests/transcripts/files`) is copied there, or made (`support.made`).

``pc2scan`` runs in this process, with the folder for ``$PWD``, and batches convert in it; every other command runs in a
shell, where it must succeed. ``?`` is the exit status; 0 if there is none. Each line below is in what the command
printed, with any white space; a line that begins with ``!`` is not. ``|`` before a line is for lines that begin with
one of these signs. A command that ends with 1 or 2 leaves the folder as it was; ``? 1 and writes`` is for one that may
write before. ``#`` is a comment.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.batches import in_this_process
from support.command import Finished, run
from support.made import MADE

if TYPE_CHECKING:
    from collections.abc import Iterator

PATTERNS = ("fixtures/hall*", "fixtures/golden*/*", "fixtures/reports/*", "tests/transcripts/files/*")
FIXTURES = {path.name: path for pattern in PATTERNS for path in ROOT.glob(pattern)}


@dataclass
class Step:
    """A command, its exit status, and what it says and does not say."""

    command: str
    status: int = 0
    writes: bool = False
    said: list[str] = field(default_factory=list)
    not_said: list[str] = field(default_factory=list)


@dataclass
class Case:
    """What is typed one after the other in a folder."""

    name: str
    steps: list[Step] = field(default_factory=list)


def cases_of(text: str) -> list[Case]:
    """Read the cases of a file.

    Raises
    ------
    ValueError
        If a line is in no case, or of no command; if two cases have one name.
    """
    cases: list[Case] = []
    for number, line in enumerate(text.splitlines(), 1):
        sign, rest = line[:1], line[1:].strip()
        if line.startswith("== "):
            cases.append(Case(line[3:].strip()))
        elif not line.strip() or sign == "#":
            continue
        elif not cases or (sign != "$" and not cases[-1].steps):
            raise ValueError(f"line {number} is of no command: {line}")
        elif sign == "$":
            cases[-1].steps.append(Step(rest))
        elif sign == "?":
            status, _, more = rest.partition(" ")
            cases[-1].steps[-1].status, cases[-1].steps[-1].writes = int(status), more == "and writes"
        elif sign == "!":
            cases[-1].steps[-1].not_said.append(_flat(rest))
        else:
            cases[-1].steps[-1].said.append(_flat(rest if sign == "|" else line))
    names = [case.name for case in cases]
    if len(names) != len(set(names)):
        raise ValueError(f"two cases have one name: {sorted(names)}")
    return cases


def check(case: Case, folder: Path) -> None:
    """Type a case's commands in an empty folder, and hold them to what is expected."""
    words = {word.partition("/")[0] for step in case.steps for word in shlex.split(step.command)}
    for name in FIXTURES.keys() & words:
        (shutil.copytree if FIXTURES[name].is_dir() else shutil.copyfile)(FIXTURES[name], folder / name)
    for name in MADE.keys() & words:
        MADE[name](folder / name)
    for step in case.steps:
        stays = step.status in {1, 2} and not step.writes
        before = sorted(_content(folder)) if stays else []
        done = _typed(step.command, folder)
        where = f"$ {step.command}\n{done.stdout}{done.stderr}"
        assert done.status == step.status, f"status {done.status}, not {step.status}: {where}"
        printed = _flat(f"{done.stdout}\n{done.stderr}")
        for text in step.said:
            assert text in printed, f"not said: {text}\n{where}"
        for text in step.not_said:
            assert text not in printed, f"said: {text}\n{where}"
        assert "Traceback" not in done.stderr, where
        # Neither a progress bar nor colours: this is no terminal.
        assert not {"\x1b", "\r"} & {*done.stdout, *done.stderr}, where
        # Options are spelled as they are typed.
        assert not re.search(r"`[a-z]\w*[=`]", done.stderr), where
        if done.stderr.startswith("error: ") and done.stdout:
            # A command that cannot begin prints nothing but its error as JSON.
            document = json.loads(done.stdout)
            assert document["exit_status"] == done.status, where
            assert document["errors"][0]["message"] in done.stderr, where
        assert not stays or sorted(_content(folder)) == before, where


def _typed(command: str, folder: Path) -> Finished:
    program, *words = shlex.split(command)
    if program == "pc2scan":
        # As a shell would replace it, for URLs of files.
        words = [word.replace("$PWD", str(folder)) for word in words]
        with in_this_process() if words[:1] == ["batch"] else nullcontext():
            return run(*words, cwd=folder)
    env = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["sh", "-ec", command], cwd=folder, env=env, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, f"$ {command}\n{done.stderr}"
    return Finished(done.returncode, done.stdout, done.stderr)


def _content(folder: Path) -> Iterator[tuple[str, bytes]]:
    for path in folder.rglob("*"):
        leads = str(path.readlink()).encode() if path.is_symlink() else b""
        yield str(path.relative_to(folder)), leads or (path.read_bytes() if path.is_file() else b"")


def _flat(text: str) -> str:
    return " ".join(text.split())


TEXTS = sorted(Path(__file__).parent.glob("*.txt"))
CASES = [
    pytest.param(case, id=f"{path.stem}: {case.name}") for path in TEXTS for case in cases_of(path.read_text("utf-8"))
]


@pytest.mark.parametrize("case", CASES)
def test_what_is_typed_ends_and_says(case: Case, tmp_path: Path) -> None:
    check(case, tmp_path)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("== a\n$ pc2scan --version\n? 1\n", "status 0, not 1"),
        ("== a\n$ pc2scan --version\nnothing of this\n", "not said: nothing of this"),
        ("== a\n$ pc2scan --version\n! pc2scan\n", "said: pc2scan"),
        ("== a\n$ pc2scan convert hall.bag -o a.bag --min-height -0.3\n$ false\n", "false"),
    ],
)
def test_a_case_can_fail(text: str, wrong: str, tmp_path: Path) -> None:
    (case,) = cases_of(text)
    with pytest.raises(AssertionError, match=wrong):
        check(case, tmp_path)


@pytest.mark.parametrize("text", ["text\n", "== a\n? 2\n", "== a\n$ true\n== a\n$ true\n"])
def test_what_is_no_transcript_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"of no command|one name"):
        cases_of(text)
