"""Losses that the format shows: each is reported with its place, and nothing else of the recording is lost."""

from __future__ import annotations

import json
import re
import struct
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import zstandard
from mcap.writer import Writer as McapLibraryWriter

from pc2scan.bags.opening import open_recording
from pc2scan.errors import DamageError
from support import ROOT
from support.builders import (
    CHATTER,
    CONTENT,
    POINTS,
    SECOND,
    T0,
    Item,
    Mcap,
    Recording,
    string,
    write_db3,
    write_mcap,
    write_rosbag1,
)
from support.command import run
from support.containers import Row, read

if TYPE_CHECKING:
    from collections.abc import Callable

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def rows_of(path: Path) -> list[Row]:
    """Every message of a sound recording."""
    return read(path, strict=True)


def ids_of(path: Path) -> dict[str, int]:
    with closing(open_recording(path)) as reader:
        return {connection.topic: connection.id for connection in reader.connections}


def report_of(*command: str | Path) -> tuple[int, str, dict[str, Any]]:
    """Exit status, standard error, and the report of a run."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "report.json")
        done = run(*command, "--quiet", "--report", path)
        assert "Traceback" not in done.stderr
        assert path.exists(), done.stderr
        return done.status, done.stderr, json.loads(path.read_text())


def drive(times: int) -> Recording:
    """The usual content over and over, 0.4 s each time."""
    items = (
        replace(item, log_time_ns=item.log_time_ns + number * 4 * SECOND // 10)
        for number in range(times)
        for item in CONTENT.items
    )
    return replace(CONTENT, items=tuple(items))


def changed(path: Path, before: bytes, after: bytes, *, last: bool = False) -> Path:
    """Replace bytes where they occur first, or last."""
    data = path.read_bytes()
    at = data.rindex(before) if last else data.index(before)
    path.write_bytes(data[:at] + after + data[at + len(before) :])
    return path


# --- Serialisations that nothing decodes ---

#: Bytes that are no CDR, among them what other readers take for compressed or empty messages.
PAYLOADS = (b"", b"\0", b"{}", ZSTD_MAGIC, ZSTD_MAGIC + b"no frame", bytes(range(256)), b"\xff" * 70_000)
FORMATS = ("", "wrong_format", "json", "ros1")


def foreign_mcap(path: Path, *, chunked: bool) -> list[Row]:
    rows = []
    with path.open("wb") as file:
        writer = McapLibraryWriter(file, chunk_size=1000, use_chunking=chunked)
        writer.start("", "tests")
        for number, name in enumerate((*FORMATS, "cbor")):
            channel = writer.register_channel(f"/foreign{number}", name, 0, {})
            for step, data in enumerate(PAYLOADS):
                rows.append((f"/foreign{number}", T0 + 1000 * number + step, data))
                writer.add_message(channel, rows[-1][1], data, rows[-1][1])
        writer.finish()  # type: ignore[no-untyped-call]
    return rows


@pytest.mark.parametrize("chunked", [True, False])
def test_repair_keeps_every_serialisation(chunked: bool, tmp_path: Path) -> None:
    rows = foreign_mcap(tmp_path / "drive.mcap", chunked=chunked)
    status, stderr, report = report_of("repair", tmp_path / "drive.mcap", "-o", tmp_path / "fixed.mcap")
    assert (status, stderr, report["messages_read"]) == (0, "", len(rows))
    assert rows_of(tmp_path / "fixed.mcap") == rows


# --- Log times that a container cannot hold ---


def with_times(*times: int) -> Recording:
    """A message of /chatter at each of these times, and the clouds of the usual content."""
    said = [Item(CHATTER, time_ns, {g: string(f"at {time_ns}", g) for g in (1, 2)}) for time_ns in times]
    return Recording((POINTS, CHATTER), (*CONTENT.of("/points"), *said))


IMPOSSIBLE = {
    "into a bag": ("mcap", "out.bag", 2**32 * SECOND),
    "from a database into a bag": ("db3", "out.bag", -1),
    "from a database into MCAP": ("db3", "out.mcap", -1),
    "into a database": ("mcap", "out", 2**63),
    "into rosbag2's MCAP": ("mcap", "out", 2**64 - 1),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
@pytest.mark.parametrize("command", ["convert", "repair"])
def test_a_log_time_that_the_container_cannot_hold(command: str, case: str, tmp_path: Path) -> None:
    kind, name, time_ns = IMPOSSIBLE[case]
    made = write_db3 if kind == "db3" else write_mcap
    source = made(tmp_path / f"drive.{kind}", with_times(T0, time_ns, T0 + 5))
    options: list[str] = []
    if command == "convert":
        options = ["--min-height", "-1", "--keep-clouds", "--static-tf", "base lidar 0 0 1 0 0 0", "--write-static-tf"]
    if "." not in name:
        options += ["--storage", "sqlite3" if "database" in case else "mcap"]
    status, stderr, report = report_of(command, source, "-o", tmp_path / name, *options)
    assert (status, report["skipped_count"]) == (3, 1), stderr
    (skipped,) = report["skipped"]
    assert (skipped["topic"], skipped["log_time_ns"]) == ("/chatter", time_ns)
    assert str(time_ns) in skipped["reason"]
    assert "skipped: /chatter, log time " in stderr
    assert f": log time {time_ns} ns" in stderr
    (chatter,) = [topic for topic in report["topics"] if topic["topic"] == "/chatter"]
    assert (chatter["messages_in"], chatter["messages_out"], chatter["skipped"]) == (3, 2, 1)
    assert [row[1] for row in rows_of(tmp_path / name) if row[0] == "/chatter"] == [T0, T0 + 5]


# --- What a recording says twice, and otherwise ---


def uncovered(folder: Path, kind: str) -> Path:
    """A recording in many chunks without compression, and without checksums of the messages and of the index."""
    if kind == "bag":
        return write_rosbag1(folder / "drive.bag", drive(3), chunk_size=5_000)
    return write_mcap(folder / "drive.mcap", drive(3), Mcap(compression="none", crcs=False))


class Otherwise(NamedTuple):
    """A recording, what is made wrong in it, and what a repair says: a regular expression."""

    make: Callable[[Path], Path]
    alter: Callable[[Path], object]
    said: str
    #: How many messages the damage is said to have cost.
    lost: int = 0


def first_chatter_is_imu_in_a_bag(path: Path) -> None:
    ids = ids_of(path)
    data = bytearray(path.read_bytes())
    field = b"\x09\0\0\0conn=" + struct.pack("<I", ids["/chatter"])
    # Of the records with this field the messages alone have a time, too.
    places = (match.end() for match in re.finditer(re.escape(field), data))
    at = next(at for at in places if b"\x0d\0\0\0time=" in data[at - 50 : at + 50])
    data[at - 4] = ids["/imu"]
    path.write_bytes(data)


def first_chatter_is_imu_in_mcap(path: Path) -> None:
    ids = ids_of(path)
    with closing(open_recording(path)) as reader:
        message = next(m for m in reader.messages() if m.connection.topic == "/chatter")
        before = struct.pack("<HIQ", ids["/chatter"], message.sequence, message.log_time_ns)
    changed(path, before, struct.pack("<H", ids["/imu"]) + before[2:])


TYPE = (b"type=std_msgs/String", b"type=std_msgs/Strinh")
BAG, MCAP = partial(uncovered, kind="bag"), partial(uncovered, kind="mcap")
CONNECTION = "the index and the content disagree: connection"

OTHERWISE = {
    "a connection in a chunk": Otherwise(BAG, partial(changed, before=TYPE[0], after=TYPE[1]), CONNECTION),
    "a connection in the index": Otherwise(
        BAG, partial(changed, before=b"topic=/chatter", after=b"topic=/chattes", last=True), CONNECTION
    ),
    "an MCAP channel in the summary": Otherwise(
        MCAP,
        partial(changed, before=b"/chatter", after=b"/chattes", last=True),
        r"channel \d+ is declared again, and differently",
    ),
    # Its connection's id is another one that there is.
    "a message's connection in a bag": Otherwise(
        BAG, first_chatter_is_imu_in_a_bag, "/chatter: 9 declared, 8 found", 1
    ),
    "a message's channel in MCAP": Otherwise(
        MCAP, first_chatter_is_imu_in_mcap, "/chatter: 9 declared, 8 found; /imu: 9 declared, 10 found", 1
    ),
}


@pytest.mark.parametrize("name", OTHERWISE)
def test_what_is_said_twice_and_otherwise_is_reported(name: str, tmp_path: Path) -> None:
    case = OTHERWISE[name]
    source = case.make(tmp_path)
    sound = rows_of(source)
    case.alter(source)
    # Who does not count the messages of each topic learns nothing of these.
    if not name.startswith("a message's"):
        with pytest.raises(DamageError):
            read(source, strict=True)
    status, stderr, report = report_of("repair", source, "-o", tmp_path / f"out{source.suffix}")
    assert status == 3
    assert re.search(case.said, stderr), stderr
    assert [damage["messages_lost"] for damage in report["damage"]] == [case.lost]
    found = rows_of(tmp_path / f"out{source.suffix}")
    # A topic may have another name now.
    assert [row[1:] for row in found] == [row[1:] for row in sound]


# --- Recordings that follow each other in one file ---


@pytest.mark.parametrize("more", [0, 0.25])
@pytest.mark.parametrize("kind", ["bag", "mcap", "mcap, no summary"])
def test_a_second_recording_in_a_file_is_reported_and_not_read(kind: str, more: float, tmp_path: Path) -> None:
    """What ``cat a b`` makes: the ids of b mean other topics. Nor is a third one read, of which there may be a part."""
    first = drive(3)
    parts = []
    for number, recording in enumerate((first, Recording(first.streams[::-1], first.items))):
        path = tmp_path / f"{number}.{kind.partition(',')[0]}"
        write_rosbag1(path, recording) if kind == "bag" else write_mcap(path, recording, Mcap(summary="no" not in kind))
        parts.append(path)
    place, both = parts[0].stat().st_size, b"".join(path.read_bytes() for path in parts)
    source, target = tmp_path / f"both{parts[0].suffix}", tmp_path / f"fixed{parts[0].suffix}"
    source.write_bytes(both + both[: int(place * more)])
    status, stderr, report = report_of("repair", source, "-o", target)
    assert status == 3
    (damage,) = [each for each in report["damage"] if each["bytes_lost"]]
    assert (damage["offset"], damage["bytes_lost"]) == (place, source.stat().st_size - place)
    assert "the recording ends here: what follows is not read" in stderr
    assert rows_of(target) == rows_of(parts[0])
    assert run("convert", source, "-o", tmp_path / "strict.mcap", "--strict").status == 1


def test_a_recording_in_a_message_is_no_second_recording(tmp_path: Path) -> None:
    """Bags are sent around in messages, too."""
    inner = write_rosbag1(tmp_path / "inner.bag", drive(1)).read_bytes().decode("latin-1")
    items = [Item(CHATTER, T0 + n, {1: string(inner, 1)}) for n in range(3)]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((CHATTER,), tuple(items)))
    assert report_of("repair", source, "-o", tmp_path / "fixed.bag")[0] == 0
    assert len(rows_of(tmp_path / "fixed.bag")) == 3


def test_memory_that_runs_out_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Compressor:
        def __init__(self, *, level: int) -> None:
            pass

        def compress(self, _: bytes) -> bytes:
            raise MemoryError

    monkeypatch.setattr(zstandard, "ZstdCompressor", Compressor)
    done = run("convert", ROOT / "fixtures" / "hall.mcap", "-o", tmp_path / "out.mcap", "--min-height", "0.1")
    assert (done.status, "Traceback" in done.stderr) == (1, False)
    assert "error: memory ran out" in done.stderr
    assert "\nhint: fewer threads take less: --jobs 1\n" in done.stderr
    assert list(tmp_path.iterdir()) == []
