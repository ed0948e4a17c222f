"""Tests that are texts: what is typed, how it ends, and what it says.

A file of transcripts is about one subject; each of its cases is a heading, commands and what is expected of them::

    == a name that nearly matches
    $ touch drive.bag
    $ pc2scan info drvie.bag
    ? 2
    error: drvie.bag: does not exist
    hint: did you mean drive.bag?

Each case runs in an empty folder; a fixture that it names (``hall.bag``, ``hall.mcap``, ``hall``) is copied there.
``pc2scan`` runs in this process, and every other command in a shell, where it must succeed. ``?`` is the exit status; 0
if there is none. Each line below is in what the command printed, with any white space; a line that begins with ``!`` is
not. ``|`` before a line is for lines that begin with one of these signs. A command that ends with 1 or 2 leaves the
folder as it was, and any other changes no file that was there, unless it is told to overwrite. ``#`` is a comment.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from support import ROOT
from support.command import Finished, run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

__all__ = ["Case", "cases_of", "check"]

FIXTURES = {path.name: path for path in (ROOT / "fixtures").glob("hall*")}


@dataclass
class Step:
    """A command, its exit status, and what it says and does not say."""

    command: str
    status: int = 0
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
            cases[-1].steps[-1].status = int(rest)
        elif sign == "!":
            cases[-1].steps[-1].not_said.append(_flat(rest))
        else:
            cases[-1].steps[-1].said.append(_flat(rest if sign == "|" else line))
    names = [case.name for case in cases]
    if len(names) != len(set(names)):
        raise ValueError(f"two cases have one name: {sorted(names)}")
    return cases


def check(
    case: Case,
    folder: Path,
    made: Mapping[str, Callable[[Path], object]] | None = None,
    command: Callable[..., Finished] = run,
) -> None:
    """Type a case's commands in an empty folder, and hold them to what is expected.

    Parameters
    ----------
    made
        Makes further files that a case may name, given their place.
    command
        Runs ``pc2scan``, as `support.command.run` does.
    """
    words = {word for step in case.steps for word in shlex.split(step.command)}
    made = made or {}
    for name in made.keys() & words:
        made[name](folder / name)
    for name in FIXTURES.keys() & words:
        (shutil.copytree if FIXTURES[name].is_dir() else shutil.copyfile)(FIXTURES[name], folder / name)
    for step in case.steps:
        before = sorted(_content(folder))
        done = _typed(step.command, folder, command)
        where = f"$ {step.command}\n{done.stdout}{done.stderr}"
        assert done.status == step.status, f"status {done.status}, not {step.status}: {where}"
        printed = _flat(f"{done.stdout}\n{done.stderr}")
        for text in step.said:
            assert text in printed, f"not said: {text}\n{where}"
        for text in step.not_said:
            assert text not in printed, f"said: {text}\n{where}"
        assert "Traceback" not in done.stderr, where
        if done.status in {1, 2}:
            assert sorted(_content(folder)) == before, where
        elif step.command.startswith("pc2scan ") and "--overwrite" not in step.command:
            assert set(before) <= set(_content(folder)), where


def _typed(line: str, folder: Path, command: Callable[..., Finished]) -> Finished:
    program, *words = shlex.split(line)
    if program == "pc2scan":
        return command(*words, cwd=folder)
    done = subprocess.run(["sh", "-ec", line], cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, f"$ {line}\n{done.stderr}"
    return Finished(done.returncode, done.stdout, done.stderr)


def _content(folder: Path) -> Iterator[tuple[str, bytes]]:
    for path in folder.rglob("*"):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            yield name, bytes(path.readlink())
        else:
            yield name, path.read_bytes() if path.is_file() else b""


def _flat(text: str) -> str:
    return " ".join(text.split())
