"""What lies beside a database: no file but pc2scan's own is created, changed, renamed or deleted for it."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from support import sampled
from support.batches import contents
from support.bounded import run_bounded
from support.builders import CONTENT, write_db3

if TYPE_CHECKING:
    from pathlib import Path

_MAGIC = bytes.fromhex("d9d505f920a163d7")

#: Every command that opens a recording, with what it takes beside that.
COMMANDS: dict[str, tuple[str, ...]] = {
    "info": (),
    "tf": (),
    "check": (),
    "repair": ("-o", "OUT/fixed.mcap"),
    "convert": ("-o", "OUT/scans.mcap"),
    "export": ("-o", "OUT/scans.csv", "--min-height", "-0.3"),
    "diff": ("SRC",),
    "map": ("-o", "OUT/map.yaml"),
}


def run(folder: Path, command: str, source: Path, *args: str) -> int:
    """Run a command whose output is in a folder of its own, and hold it to having changed nothing else."""
    out = folder / "out"
    out.mkdir(exist_ok=True)
    others = folder / "others"
    before = contents(others)
    words = [word.replace("SRC", str(source)).replace("OUT", str(out)) for word in (*COMMANDS[command], *args)]
    done = run_bounded(command, source, *words)
    assert contents(others) == before
    return done.status


def journal(database: Path, *, names: Path) -> bytes:
    """A rollback journal that undoes nothing, of a transaction over several databases: one more file knows its end."""
    head = database.read_bytes()[:100]
    (page,) = struct.unpack_from(">H", head, 16)
    count = database.stat().st_size // page
    header = (_MAGIC + struct.pack(">IIIII", 0, 0, count, 512, page)).ljust(512, b"\0")
    name = str(names).encode()
    return header + struct.pack(">I", 0x40000000 // page + 1) + name + struct.pack(">II", len(name), sum(name)) + _MAGIC


def recording(folder: Path) -> Path:
    """A database in a folder in which nothing may change."""
    (folder / "others").mkdir()
    return write_db3(folder / "others" / "drive.db3", CONTENT)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_that_a_journal_names_stays(command: str, tmp_path: Path) -> None:
    source = recording(tmp_path)
    victim = tmp_path / "others" / "victim"
    victim.write_text("years of work")
    source.with_name("drive.db3-journal").write_bytes(journal(source, names=victim))
    run(tmp_path, command, source)
    assert victim.read_text() == "years of work"


def test_a_journal_that_names_a_file_is_refused(tmp_path: Path) -> None:
    source = recording(tmp_path)
    source.with_name("drive.db3-journal").write_bytes(journal(source, names=tmp_path / "not" / "there"))
    done = run_bounded("convert", source, "-o", tmp_path / "out.mcap")
    assert done.status == 1
    assert "drive.db3-journal: is of a transaction over several databases" in done.stderr
    assert not (tmp_path / "out.mcap").exists()


SIDES = [
    (suffix, kind)
    for suffix in ("-journal", "-wal", "-shm")
    for kind in ("link to a file", "link to nothing", "link to a directory", "text", "empty")
]


@pytest.mark.parametrize(("suffix", "kind"), sampled(SIDES, 7))
def test_whatever_lies_beside_a_database_stays(suffix: str, kind: str, tmp_path: Path) -> None:
    source = recording(tmp_path)
    side = source.with_name(f"drive.db3{suffix}")
    other = tmp_path / "others" / "letters"
    other.write_text("years of work " * 99)
    if kind == "link to a file":
        side.symlink_to(other)
    elif kind == "link to nothing":
        side.symlink_to(tmp_path / "others" / "nowhere")
    elif kind == "link to a directory":
        side.symlink_to(tmp_path)
    else:
        side.write_text("not a log" * 99 if kind == "text" else "")
    assert run(tmp_path, "convert", source) in (0, 3)


@pytest.mark.parametrize(
    "name", ["a?mode=rwc.db3", "a#b.db3", "a%41.db3", "file:a.db3", ":memory:", f"{'a' * 251}.db3"]
)
def test_names_that_mean_something_to_sqlite(name: str, tmp_path: Path) -> None:
    source = recording(tmp_path)
    source = source.rename(source.with_name(name))
    assert run(tmp_path, "info", source) == 0
