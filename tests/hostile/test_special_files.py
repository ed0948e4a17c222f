"""FIFOs, sockets and devices where a file should be, links that lead nowhere, and names longer than names can be."""

from __future__ import annotations

import os
import shutil
import socket
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from support import sampled
from support.bounded import run_bounded
from support.builders import CONTENT, write_rosbag1, write_rosbag2
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable

TABLES = Path(__file__).with_name("special_files.txt")


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


KINDS: dict[str, Callable[[Path], object]] = {
    "FIFO": os.mkfifo,
    "socket": make_socket,
    "device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # The path of a socket has at most 107 bytes.
    monkeypatch.chdir(tmp_path)
    return Path()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["metadata.yaml", "drive_0.db3"])
def test_in_place_of_a_part_of_a_recording(name: str, kind: str, folder: Path) -> None:
    source = write_rosbag2(folder / "drive", CONTENT)
    (source / name).unlink()
    KINDS[kind](source / name)
    for command in (("info", source), ("convert", source, "-o", "out.bag"), ("diff", source, source)):
        done = run_bounded(*command)
        assert done.status in (1, 2)
        assert not Path("out.bag").exists()
        assert name != "metadata.yaml" or "a device, not a file" in done.stderr


@pytest.mark.parametrize(
    ("kind", "line"), sampled([(kind, line) for (line,) in rows(TABLES, "in place of an input") for kind in KINDS], 11)
)
def test_in_place_of_an_input(kind: str, line: str, folder: Path) -> None:
    write_rosbag1(folder / "drive.bag", CONTENT)
    KINDS[kind](folder / "SPECIAL")
    done = run_bounded(*line.split())
    assert done.status in (1, 2)
    assert "a file" in done.stderr
    assert not Path("out.bag").exists()


#: LONG is a name that no file can have.
LONG = "a" * 300


@pytest.mark.parametrize("line", [line for (line,) in rows(TABLES, "names and links")])
def test_names_that_are_too_long_and_links_without_end(line: str, folder: Path) -> None:
    write_rosbag1(folder / "drive.bag", CONTENT)
    (folder / "case").mkdir()
    shutil.copy(folder / "drive.bag", folder / "case" / "input.bag")
    (folder / "loop").symlink_to("loop")
    before = set(folder.iterdir())
    words = line.replace("LONG", LONG).split()
    done = run_bounded(*words)
    if done.status in (1, 2):
        assert set(folder.iterdir()) - before <= {Path("out.bag")}
    if words[0] == "convert" and words[-2] == "-o" and len(words[-1]) > 200 and "/" not in words[-1]:
        assert "File name too long" in done.stderr
