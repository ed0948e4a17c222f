"""What only a process shows: outputs that are full or closed, permissions, terminals."""

from __future__ import annotations

import fcntl
import os
import pty
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from support import HALL, ROOT, sampled
from support.command import COMMAND, environment
from support.tables import rows

GOLDEN = ROOT / "fixtures" / "golden"
TABLES = Path(__file__).with_name("standard_output.txt")
PLACES = {"HALL": str(HALL), "GOLDEN": str(GOLDEN), "MCAP": str(HALL.with_suffix(".mcap"))}
PLACES["SCANS"] = str(GOLDEN / "defaults" / "expected.bag")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(("words", "status"), sampled(rows(TABLES, "without room"), 1))
def test_output_without_room_is_an_error(words: str, status: int, tmp_path: Path) -> None:
    command = [*COMMAND, *(PLACES.get(word, word) for word in words.split())]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, env=environment(), check=False
        )
    assert done.returncode == status
    assert done.stderr.startswith("error: standard output cannot be written: No space left on device")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("words", sampled([f"info {HALL}", f"tf {HALL}", f"diff {HALL} {HALL}", "convert --help"], 1))
def test_a_reader_that_has_read_enough_ends_it_quietly(words: str) -> None:
    command = [*COMMAND, *words.split()]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment()) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (141, b"")


#: Root may read and write all files, whatever their permissions.
WITHOUT_RIGHTS = (
    "setpriv",
    "--bounding-set=-dac_override,-dac_read_search",
    "--inh-caps=-dac_override,-dac_read_search",
)


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("setpriv") is None, reason="setpriv is not there")
@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("info secret.bag", "error: secret.bag: cannot be read: Permission denied\n"),
        ("convert folder/hall.bag", "error: folder/hall_scan.bag: its directory is not writable\nhint: "),
    ],
)
def test_what_may_not_be_read_or_written(words: str, error: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    shutil.copy(HALL, tmp_path / "folder" / "hall.bag")
    shutil.copy(HALL, tmp_path / "secret.bag")
    (tmp_path / "folder").chmod(0o555)
    (tmp_path / "secret.bag").chmod(0)
    command = [*(WITHOUT_RIGHTS if os.getuid() == 0 else ()), *COMMAND, *words.split()]
    try:
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment(), check=False)
    finally:
        (tmp_path / "folder").chmod(0o755)
    assert done.returncode in (1, 2)
    assert done.stderr.startswith(error)


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


@pytest.mark.parametrize(
    ("words", "narrow"), sampled([(words, n % 2 == 0) for n, (words,) in enumerate(rows(TABLES, "in a terminal"))], 1)
)
def test_everything_fits_into_the_terminal(words: str, narrow: bool, tmp_path: Path) -> None:
    """Into a narrow one with a progress bar, or into as many columns as a variable says."""
    columns = 60
    arguments = [str(tmp_path / word) if word == "o.bag" else PLACES.get(word, word) for word in words.split()]
    told = {} if narrow else {"COLUMNS": str(columns), "TERM": "dumb"}
    text = shown(*arguments, columns=columns if narrow else 200, NO_COLOR="1", **told)
    # What is visible of a line is what was written after the bar was erased.
    visible = [line.rpartition("\r")[2].removeprefix("\x1b[2K") for line in text.split("\n")]
    lines = [line for line in visible if "\x1b" not in line]
    assert len(lines) > 2
    # A path or another word longer than the screen cannot be broken, and a command is not.
    long = [line.strip() for line in lines if len(line) > columns and not line.startswith("next: ")]
    assert [line for line in long if " " in line and not line.startswith("pc2scan ")] == []


def test_warnings_replace_the_progress_bar(tmp_path: Path) -> None:
    text = shown("convert", HALL, "-o", tmp_path / "o.bag", "--min-height=-1", columns=80)
    before, found, warning = text.partition("\x1b[1;33mwarning:\x1b[0m /points: the floor is within the heights")
    assert found
    assert before.endswith("\r\x1b[2K")
    assert warning.startswith(": it is at z = -0.60 m in\n  'lidar'")


@pytest.mark.parametrize(
    ("variables", "columns", "coloured"),
    sampled([({}, 80, True), ({"NO_COLOR": "1"}, 80, False), ({}, None, False), ({"TERM": "dumb"}, 80, False)], 2),
)
def test_terminals_have_colours_unless_they_are_unwanted(
    variables: dict[str, str], columns: int | None, *, coloured: bool
) -> None:
    text = shown("info", "nothing.bag", columns=columns, **variables)
    assert ("\x1b[1;31merror:\x1b[0m nothing.bag" in text) is coloured
    assert ("\x1b" in text) is coloured
