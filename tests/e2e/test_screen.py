"""What a terminal shows: lines that fit, and colours where they are wanted."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import shlex
import struct
import subprocess
import termios
from typing import TYPE_CHECKING

import pytest

from pc2scan.compare.diff import diff
from pc2scan.inspect.check import check
from support import ROOT
from support.builders import write_mcap
from support.command import COMMAND, environment, run
from support.scan_recordings import recording, scans

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


def shown(*arguments: str | Path, columns: int | None = None, **variables: str) -> str:
    """What a command prints on a pipe, or with ``columns`` on a terminal so wide."""
    command = [*COMMAND, *map(str, arguments)]
    env = {name: value for name, value in environment().items() if name not in ("COLUMNS", "NO_COLOR", "FORCE_COLOR")}
    env |= {"TERM": "xterm", **variables}
    if columns is None:
        done = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env, timeout=120, check=False
        )
        return done.stdout
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=env)
    os.close(theirs)
    data = b""
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:  # the terminal was closed
            break
        if not piece:
            break
        data += piece
    process.wait(60)
    os.close(ours)
    return data.decode().replace("\r\n", "\n")


COMMANDS: dict[str, list[str | Path]] = {
    "info": ["info", HALL],
    "tf": ["tf", HALL],
    "lookup": ["tf", HALL, "--lookup", "base_link", "nothing"],
    "diff": ["diff", HALL, ROOT / "fixtures" / "hall.mcap"],
    "convert": ["convert", HALL, "-o", "o.bag", "--overwrite", "--target-frame", "base_link"],
    "verbose": ["convert", HALL, "-o", "o.bag", "--overwrite", "--preset", "gmapping", "-v"],
    "wrong": ["convert", HALL, "-o", "o.bag", "--angle-max", "90"],
    "unknown": ["convert", HALL, "-o", "o.bag", "--no-such-option"],
    "batch": ["batch", HALL, "-o", "o.bag", "--target-frame", "base_link"],
    "map": ["map", HALL, "--png", "o.bag", "--overwrite"],
    "golden": ["golden", ROOT / "fixtures" / "golden", "-k", "tf_"],
    "help": ["convert", "--help"],
}


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("columns", [80, 60])
def test_everything_fits(name: str, columns: int, tmp_path: Path) -> None:
    arguments = [tmp_path / "o.bag" if word == "o.bag" else word for word in COMMANDS[name]]
    text = shown(*arguments, columns=columns, NO_COLOR="1")
    # What is visible of a line is what was written after the bar was erased.
    visible = [line.rpartition("\r")[2].removeprefix("\x1b[2K") for line in text.split("\n")]
    lines = [line for line in visible if "\x1b" not in line]
    lines += shown(*arguments, columns=200, COLUMNS=str(columns), NO_COLOR="1", TERM="dumb").split("\n")
    assert len(lines) > 2
    # A path or another word longer than the screen cannot be broken.
    assert [line for line in lines if len(line) > columns and " " in line.removesuffix(" \\").strip()] == []


def test_warnings_replace_the_progress_bar(tmp_path: Path) -> None:
    text = shown("convert", HALL, "-o", tmp_path / "o.bag", "--min-height=-1", columns=80)
    before, found, warning = text.partition("\x1b[1m\x1b[33mwarning:\x1b[0m /points: the floor is within the heights")
    assert found
    assert before.endswith("\r\x1b[2K")
    assert warning.startswith(": it is at z = -0.60 m in\n  'lidar'")


def test_pipes_get_every_line_as_it_is(tmp_path: Path) -> None:
    text = shown("convert", HALL, "-o", tmp_path / "o.bag", "--angle-max", "90", COLUMNS="60")
    assert len(text.splitlines()) == 2
    assert "\x1b" not in text


def test_json_is_never_wrapped() -> None:
    document = shown("tf", HALL, "--json", columns=40, NO_COLOR="1")
    assert json.loads(document)["trees"]


@pytest.mark.parametrize(
    ("variables", "columns", "coloured"),
    [
        ({}, 80, True),
        ({"NO_COLOR": "1"}, 80, False),
        ({"TERM": "dumb"}, 80, False),
        ({}, None, False),
        ({"FORCE_COLOR": "1"}, None, True),
        ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, None, False),
    ],
)
def test_colours(variables: dict[str, str], columns: int | None, *, coloured: bool) -> None:
    text = shown("info", "nothing.bag", columns=columns, **variables)
    assert ("\x1b[1m\x1b[31merror:\x1b[0m nothing.bag" in text) is coloured
    assert ("\x1b" in text) is coloured
    same = shown("diff", HALL, HALL, columns=columns, **variables)
    assert ("\x1b[1m\x1b[32msame:\x1b[0m" in same) is coloured


def test_a_command_that_is_too_long_stays_one_for_the_shell(tmp_path: Path) -> None:
    folder = tmp_path / "a folder with a name of some length" / "and another one in it"
    folder.mkdir(parents=True)
    text = shown("convert", HALL, "-o", folder / "scan.bag", columns=60, NO_COLOR="1")
    command = text[text.index("next: ") + len("next: ") :].split("warning:")[0]
    words = subprocess.run(
        ["sh", "-c", f"set -- {command.strip()}\nprintf '%s' $#"], capture_output=True, check=True
    ).stdout
    assert int(words) == 4


def test_a_wrapped_command_stays_one_for_the_shell(tmp_path: Path) -> None:
    """A name with spaces and quotes is not broken: within quotes a backslash is no continuation."""
    folder = tmp_path / "a rather long name of a folder that it's hard to fit"
    folder.mkdir()
    text = shown("convert", HALL, "-o", f"{folder}/", "--to", "rosbag2", columns=60, NO_COLOR="1")
    command = text[text.index("next: ") + len("next: ") :]
    assert "\\\n" in command
    # As a shell reads it.
    assert shlex.split(command.replace("\\\n", "")) == ["ros2", "bag", "play", str(folder / "hall_scan"), "--clock"]


@pytest.mark.parametrize("command", ["check", "diff"])
def test_check_and_diff_have_the_progress_bar(command: str, tmp_path: Path) -> None:
    assert run("convert", HALL, "-o", tmp_path / "scan.bag", "--min-height=-1").status == 0
    sources = [tmp_path / "scan.bag"] * (2 if command == "diff" else 1)
    assert "messages" in shown(command, *sources, columns=120)
    assert "\x1b[?25l" in shown(command, *sources, columns=120)
    assert "\x1b[?25l" not in shown(command, *sources, "--json", columns=120)
    assert "\x1b" not in shown(command, *sources)


def test_how_far_a_comparison_is(tmp_path: Path) -> None:
    many = write_mcap(tmp_path / "many.mcap", recording({"/scan": scans(200)}))
    told: list[tuple[int, int, int]] = []
    assert diff(many, many, progress=lambda *step: told.append(step)).same
    assert len(told) == 6
    assert all(0 <= done <= total for done, total, _ in told)
    assert [messages for _, _, messages in told] == [32, 64, 96, 128, 160, 192]
    told.clear()
    check(many, progress=lambda *step: told.append(step))
    assert [messages for _, _, messages in told] == [0, 64, 128, 192]
