"""FIFOs, sockets and devices where a file should be, links that lead nowhere, and names longer than names can be."""

from __future__ import annotations

import os
import shutil
import socket
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from support.builders import CONTENT, write_rosbag1, write_rosbag2
from support.command import Finished, run

if TYPE_CHECKING:
    from collections.abc import Callable


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


KINDS: dict[str, Callable[[Path], object]] = {
    "FIFO": os.mkfifo,
    "socket": make_socket,
    "device": lambda path: path.symlink_to("/dev/zero"),
}


def at_once(*args: str | Path) -> Finished:
    """Run a command that must neither wait for anybody nor read without end."""
    done = run(*args)
    assert "Traceback" not in done.stderr, done.stderr
    assert done.status in (0, 1, 2, 3)
    assert done.status in (0, 3) or done.stderr.startswith("error: "), done.stderr
    return done


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # The path of a socket has at most 107 bytes.
    monkeypatch.chdir(tmp_path)
    return Path()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["metadata.yaml", "part"])
def test_in_place_of_a_part_of_a_recording(name: str, kind: str, folder: Path) -> None:
    source = write_rosbag2(folder / "drive", CONTENT)
    path = next(source.glob("*.db3")) if name == "part" else source / name
    path.unlink()
    KINDS[kind](path)
    for command in (("info", source), ("convert", source, "-o", folder / "out.bag"), ("diff", source, source)):
        done = at_once(*command)
        assert done.status in (1, 2)
        assert not (folder / "out.bag").exists()
    if name == "metadata.yaml":
        assert f"it is a {kind}, not a file" in done.stderr


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("log", ["-wal", "-journal"])
def test_in_place_of_a_log(log: str, kind: str, folder: Path) -> None:
    source = write_rosbag2(folder / "drive", CONTENT)
    (database,) = source.glob("*.db3")
    KINDS[kind](database.with_name(database.name + log))
    assert at_once("info", source).status in (0, 1)
    assert at_once("info", database).status in (0, 1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "SPECIAL"),
        ("tf", "SPECIAL"),
        ("check", "SPECIAL"),
        ("convert", "SPECIAL"),
        ("repair", "SPECIAL"),
        ("diff", "SPECIAL", "SRC"),
        ("diff", "SRC", "SPECIAL"),
        ("convert", "SRC", "-o", "out.bag", "--params-file", "SPECIAL"),
        ("convert", "SRC", "-o", "out.bag", "--static-tf-file", "SPECIAL", "--target-frame", "odom"),
        ("convert", "SRC", "-o", "out.bag", "--tf-from", "SPECIAL", "--target-frame", "odom"),
    ],
    ids=" ".join,
)
def test_in_place_of_an_input(arguments: tuple[str, ...], kind: str, folder: Path) -> None:
    write_rosbag1(folder / "drive.bag", CONTENT)
    KINDS[kind](folder / "special")
    done = at_once(*(word.replace("SPECIAL", "special").replace("SRC", "drive.bag") for word in arguments))
    assert done.status in (1, 2)
    assert "a file" in done.stderr
    assert not (folder / "out.bag").exists()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["case.yaml", "params.yaml", "expected.txt", "input.bag"])
def test_in_a_golden_case(name: str, kind: str, folder: Path) -> None:
    case = folder / "case"
    case.mkdir()
    if name != "input.bag":
        write_rosbag1(case / "input.bag", CONTENT)
    KINDS[kind](case / name)
    done = run("golden", folder)
    assert "Traceback" not in done.stderr, done.stderr
    assert done.status in (1, 2)


LONG = "a" * 300


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", LONG),
        ("check", LONG),
        ("tf", LONG),
        ("golden", LONG),
        ("convert", LONG, "-o", "out.bag"),
        ("diff", "drive.bag", LONG),
        ("repair", "drive.bag", "-o", LONG),
        *(
            ("convert", "drive.bag", *further)
            for further in (
                ("-o", f"{LONG}.bag"),
                ("-o", f"{LONG}.mcap"),
                ("-o", LONG),
                ("-o", f"{LONG}/out.bag"),
                ("-o", LONG, "--storage", "sqlite3", "--overwrite"),
                ("-o", f"{'a' * 240}.bag"),
                ("-o", "out.bag", "--report", LONG),
                ("-o", "out.bag", "--report", f"{LONG}/report.json"),
                ("-o", "out.bag", "--params-file", LONG),
                ("-o", "out.bag", "--static-tf-file", LONG, "--target-frame", "odom"),
                ("-o", "out.bag", "--tf-from", LONG, "--target-frame", "odom"),
                ("-o", "loop"),
                ("-o", "loop/out.bag"),
                ("-o", "out.bag", "--report", "loop"),
            )
        ),
        ("golden", "case", "--junit", LONG),
        ("golden", "case", "--junit", f"{LONG}/junit.xml"),
        ("info", "loop"),
        ("golden", "loop"),
    ],
    ids=lambda words: " ".join(words).replace(LONG, "LONG"),
)
def test_names_that_are_too_long_and_links_without_end(arguments: tuple[str, ...], folder: Path) -> None:
    write_rosbag1(folder / "drive.bag", CONTENT)
    (folder / "case").mkdir()
    shutil.copy(folder / "drive.bag", folder / "case" / "input.bag")
    (folder / "loop").symlink_to("loop")
    before = set(folder.iterdir())
    done = at_once(*arguments)
    if done.status in (1, 2):
        assert set(folder.iterdir()) - before <= {Path("out.bag")}
    if (
        arguments[:2] == ("convert", "drive.bag")
        and arguments[-2] == "-o"
        and "/" not in arguments[-1]
        and "loop" not in arguments
    ):
        assert "at most" in done.stderr


def test_a_part_with_a_name_that_is_too_long(folder: Path) -> None:
    source = write_rosbag2(folder / "drive", CONTENT)
    text = (source / "metadata.yaml").read_text()
    (source / "metadata.yaml").write_text(text.replace(next(source.glob("*.db3")).name, f"{LONG}.db3"))
    done = at_once("info", source)
    assert done.status == 1
    assert "which is not in the directory" in done.stderr
