"""Losses that the format shows: each is reported with its place, and nothing else of the recording is lost."""

from __future__ import annotations

import json
import re
import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import zstandard
from mcap.writer import Writer as McapLibraryWriter

import pc2scan
from fuzz.mutants.mcap import records as mcap_records
from fuzz.mutants.mutate import fields_of
from fuzz.mutants.rosbag1 import FIRST_LINE, raw_records
from pc2scan.bags.opening import open_recording
from pc2scan.errors import DamageError, ResultError, UsageError
from support import ROOT, SHARED, needs_shared, sampled
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
    write_rosbag2,
)
from support.command import run
from support.containers import Row, read
from support.mcap_files import altered_index, library_file
from support.rosbag1_files import connection
from support.rosbag1_files import string as string_of
from support.rosbag1_files import write as write_bag

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


def lost(report: dict[str, Any]) -> list[int]:
    return sorted(damage["messages_lost"] for damage in report["damage"])


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


def respelled(path: Path, topic: str, before: str, after: str) -> None:
    """Replace the first text in ``metadata.yaml`` behind a topic's name."""
    text = path.read_text()
    at = text.index(before, text.index(f"name: {topic}"))
    path.write_text(text[:at] + after + text[at + len(before) :])


# --- Serialisations that nothing decodes ---

#: Bytes that are no CDR, among them what other readers take for compressed or empty messages.
PAYLOADS = (b"", b"\0", b"{}", ZSTD_MAGIC, ZSTD_MAGIC + b"no frame", bytes(range(256)), b"\xff" * 70_000)
FORMATS = ("", "wrong_format", "json", "ros1")


def foreign_db3(path: Path) -> list[Row]:
    """A ``.db3`` with a topic in each serialisation format and one in CDR; returns what is in it."""
    write_db3(path, Recording((CHATTER,), tuple(CONTENT.of("/chatter"))))
    rows = [("/chatter", item.log_time_ns, item.data[2]) for item in CONTENT.of("/chatter")]
    with closing(sqlite3.connect(path)) as database, database:
        # The first message decides nothing about the others.
        for number, name in enumerate(FORMATS):
            topic = f"/foreign{number}"
            (topic_id,) = database.execute(
                "INSERT INTO topics(name, type, serialization_format, offered_qos_profiles, type_description_hash)"
                " VALUES (?, 'fleet_msgs/msg/Blob', ?, '', '') RETURNING id",
                (topic, name),
            ).fetchone()
            for step, data in enumerate(PAYLOADS):
                row = (topic, T0 - SECOND + step * 10 + number, data)
                rows.append(row)
                database.execute(
                    "INSERT INTO messages(id, topic_id, timestamp, data) VALUES (?, ?, ?, ?)",
                    (-1000 + 100 * number + step, topic_id, *row[1:]),
                )
    return sorted(rows, key=lambda row: row[1])


def foreign_mcap(path: Path, *, chunked: bool = True) -> list[Row]:
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


FOREIGN: dict[str, Callable[[Path], list[Row]]] = {
    "drive.db3": foreign_db3,
    "drive/drive_0.db3": foreign_db3,
    "drive/drive_0.mcap": foreign_mcap,
    "drive.mcap": foreign_mcap,
    "unchunked.mcap": lambda path: foreign_mcap(path, chunked=False),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_repair_keeps_every_serialisation(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    rows = FOREIGN[name](path)
    source = path.parent if "/" in name else path
    target = tmp_path / ("fixed.mcap" if source.suffix == ".mcap" else "fixed")
    for options in ([], ["--compression", "lz4"]) if source.suffix == ".mcap" else ([],):
        status, stderr, report = report_of("repair", source, "-o", target, "--overwrite", *options)
        assert (status, stderr, report["messages_read"]) == (0, "", len(rows))
        assert rows_of(target) == rows
    if name == "drive.db3":
        with closing(sqlite3.connect(target / "fixed_0.db3")) as database:
            formats = database.execute("SELECT serialization_format FROM topics ORDER BY id").fetchall()
            stored = database.execute("SELECT data FROM messages ORDER BY timestamp, id").fetchall()
        assert formats == [("cdr",), *((name,) for name in FORMATS)]
        assert [data for (data,) in stored] == [data for _, _, data in rows]


def test_a_conversion_passes_on_what_no_one_decodes(tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT)
    with closing(sqlite3.connect(source / "drive_0.db3")) as database, database:
        database.execute("UPDATE topics SET serialization_format = 'wrong_format' WHERE name = '/chatter'")
    before, after = (f"serialization_format: {name}" for name in ("cdr", "wrong_format"))
    respelled(source / "metadata.yaml", "/chatter", before, after)
    status, _, report = report_of("convert", source, "-o", tmp_path / "out", "--min-height", "-1")
    assert status == 0
    assert {t["topic"]: t["action"] for t in report["topics"]}["/chatter"] == "passed"
    expected = [item.data[2] for item in CONTENT.of("/chatter")]
    assert [data for topic, _, data in rows_of(tmp_path / "out") if topic == "/chatter"] == expected


MODES = list(product(["sqlite3", "mcap"], ["", "file", "message"]))


@pytest.mark.parametrize(("storage", "mode"), sampled(MODES, 3))
def test_an_empty_storage_identifier_is_told_from_the_files(storage: str, mode: str, tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT, storage=storage, mode=mode)
    rows = rows_of(source)
    path = source / "metadata.yaml"
    path.write_text(re.sub(r"storage_identifier: \w+", 'storage_identifier: ""', path.read_text()))
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "fixed")
    assert (status, stderr) == (0, "")
    assert rows_of(tmp_path / "fixed") == rows
    with closing(open_recording(tmp_path / "fixed")) as reader:
        assert reader.summary.storage == storage


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


def large(version: int, *times: int) -> Recording:
    """Messages so large that each has a chunk, which can be copied whole."""
    items = [Item(CHATTER, t, {version: string("a" * 400_000, version)}) for t in times]
    return Recording((CHATTER,), tuple(items))


def test_a_chunk_with_a_time_too_late_for_rosbag2_is_not_copied(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "drive.mcap", large(2, T0, T0 + 1, 2**63 + 5))
    status, _, report = report_of("repair", source, "-o", tmp_path / "out")
    assert (status, report["skipped_count"]) == (3, 1)
    text = (tmp_path / "out" / "metadata.yaml").read_text()
    assert str(T0) in text
    assert "message_count: 2" in text


def test_fail_stops_at_a_log_time_that_does_not_fit(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "drive.mcap", with_times(T0, 2**32 * SECOND))
    done = run("convert", source, "-o", tmp_path / "out.bag", "--strict")
    assert done.status == 1
    assert "is outside the 0 to 4294967295 s" in done.stderr
    assert not (tmp_path / "out.bag").exists()


# --- What a recording says twice, and otherwise ---


def uncovered(folder: Path, kind: str, times: int = 3, *, chunked: bool = True) -> Path:
    """A recording in many chunks without compression, and without checksums of the messages and of the index."""
    if kind == "bag":
        return write_rosbag1(folder / "drive.bag", drive(times), chunk_size=5_000)
    return write_mcap(folder / "drive.mcap", drive(times), Mcap(compression="none", crcs=False, chunked=chunked))


class Otherwise(NamedTuple):
    """A recording, what is made wrong in it, and what a repair says.

    Attributes
    ----------
    said
        Regular expressions.
    lost
        How many messages each damage is said to have cost; None where that is not looked at.
    named
        Whether a topic's name or type is another: messages are compared without it.
    """

    make: Callable[[Path], Path]
    alter: Callable[[Path], object]
    said: tuple[str, ...]
    lost: tuple[int, ...] | None = (0,)
    named: bool = True


def sound_mcap(folder: Path) -> Path:
    return write_mcap(folder / "drive.mcap", drive(3))


def with_extras(folder: Path) -> Path:
    rows = [(number % 2, T0 + number, b"\0\1\0\0") for number in range(9)]
    return library_file(folder / "drive.mcap", rows, extras=True)


def rosbag2(folder: Path, storage: str = "sqlite3") -> Path:
    return write_rosbag2(folder / "drive", drive(3), storage=storage)


def index_says(kind: str, field: str, value: Any) -> Callable[[Path], object]:
    """The record's CRC is right."""
    return lambda path: altered_index(path, kind, lambda record: setattr(record, field, value))


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


def first_chatter_is_imu_in_a_database(path: Path) -> None:
    with closing(sqlite3.connect(path / "drive_0.db3")) as database, database:
        ids = dict(database.execute("SELECT name, id FROM topics"))
        (row,) = database.execute("SELECT min(id) FROM messages WHERE topic_id = ?", (ids["/chatter"],)).fetchone()
        database.execute("UPDATE messages SET topic_id = ? WHERE id = ?", (ids["/imu"], row))


def counted_otherwise(path: Path) -> None:
    respelled(path / "metadata.yaml", "/chatter", "message_count: 9", "message_count: 8")
    respelled(path / "metadata.yaml", "/imu", "message_count: 9", "message_count: 10")


DESCRIBED = {
    "topic": (b"topic=/chatter", b"topic=/chattes"),
    "type": (b"type=std_msgs/String", b"type=std_msgs/Strinh"),
    "definition": (b"# Charge of the pack", b"# Charge of the sack"),
    "md5sum": (b"md5sum=992ce8a1687cec8c8bd883ec73ca41d1", b"md5sum=992ce8a1687cec8c8bd883ec73ca41d2"),
}
STATISTICS = {
    ("message_start_time", T0 + SECOND): "the index and the content disagree: the statistics have log times",
    ("message_end_time", T0 + 1): "the index and the content disagree: the statistics have log times",
    ("chunk_count", 90): "the statistics count 90 chunks",
}
ONE_MORE = "/chatter: 9 declared, 8 found; /imu: 9 declared, 10 found"

OTHERWISE: dict[str, Otherwise] = {
    **{
        f"a connection's {what} {place}": Otherwise(
            partial(uncovered, kind="bag"),
            partial(changed, before=DESCRIBED[what][0], after=DESCRIBED[what][1], last=last),
            ("the index and the content disagree: connection", "no message is known to be missing"),
            named=False,
        )
        for what in DESCRIBED
        for last, place in ((False, "in a chunk"), (True, "in the index"))
    },
    **{
        # The library declares channels within the chunks, and again in the summary.
        f"an MCAP channel in the {part}": Otherwise(
            partial(uncovered, kind="mcap", chunked=part != "data"),
            partial(changed, before=b"/chatter", after=b"/chattes", last=part == "summary"),
            (r"channel \d+ is declared again, and differently",),
            named=False,
        )
        for part in ("summary", "data", "chunk")
    },
    # Its connection's id is another one that there is.
    "a message's connection in a bag": Otherwise(
        partial(uncovered, kind="bag"),
        first_chatter_is_imu_in_a_bag,
        ("51 messages, 51 were found", "/chatter: 9 declared, 8 found", "/imu: 9 declared, 10 found"),
        (1,),
        named=False,
    ),
    "a message's channel in MCAP": Otherwise(
        partial(uncovered, kind="mcap"), first_chatter_is_imu_in_mcap, (ONE_MORE,), (1,), named=False
    ),
    "a row's topic": Otherwise(rosbag2, first_chatter_is_imu_in_a_database, (ONE_MORE,), (1,), named=False),
    **{
        f"statistics: {field} {value}": Otherwise(
            sound_mcap, index_says("Statistics", field, value), (said, "recovered: 51 messages; no bytes")
        )
        for (field, value), said in STATISTICS.items()
    },
    "more messages than a bag declares": Otherwise(
        lambda folder: write_rosbag1(folder / "drive.bag", drive(1)),
        lambda path: changed(path, struct.pack("<II", 4, 3), struct.pack("<II", 4, 2), last=True),
        ("2 declared, 3 found", "the index and the content disagree: the chunk with data .* counted are "),
        (0, 0),
    ),
    **{
        f"counts by topic of {storage}": Otherwise(
            partial(rosbag2, storage=storage),
            counted_otherwise,
            (
                "metadata.yaml counts 51 messages, its files have 51",
                "/chatter: 8 declared, 9 found; /imu: 10 declared, 9 found",
            ),
            (1,),
        )
        for storage in ("sqlite3", "mcap")
    },
}


@pytest.mark.parametrize("name", OTHERWISE)
def test_what_is_said_twice_and_otherwise_is_reported(name: str, tmp_path: Path) -> None:
    case = OTHERWISE[name]
    source = case.make(tmp_path)
    targets = [tmp_path / f"{when}{source.suffix}" for when in ("before", "after")]
    assert report_of("repair", source, "-o", targets[0])[0] == 0
    sound = rows_of(source)
    case.alter(source)
    # Who does not count the messages of each topic learns nothing of these.
    if not name.startswith("a message's"):
        with pytest.raises(DamageError):
            read(source, strict=True)
    status, stderr, report = report_of("repair", source, "-o", targets[1])
    assert status == 3
    for words in case.said:
        assert re.search(words, stderr), stderr
    assert case.lost in (None, tuple(lost(report)))
    found = rows_of(targets[1])
    assert found == sound if case.named else [row[1:] for row in found] == [row[1:] for row in sound]
    if source.is_file() and case.named and name != "more messages than a bag declares":
        assert targets[1].read_bytes() == targets[0].read_bytes()


#: What no reader needs: the content has it, or shows it.
NEEDLESS = {
    ("Statistics", "channel_count"): 90,
    ("Statistics", "schema_count"): 1,
    ("MetadataIndex", "name"): "other",
    ("AttachmentIndex", "data_size"): 1,
}


@pytest.mark.parametrize(("kind", "field"), NEEDLESS)
def test_what_only_an_index_has_wrong_changes_nothing(kind: str, field: str, tmp_path: Path) -> None:
    source = with_extras(tmp_path)
    targets = [tmp_path / f"{when}.mcap" for when in ("before", "after")]
    assert report_of("repair", source, "-o", targets[0])[0] == 0
    altered_index(source, kind, lambda record: setattr(record, field, NEEDLESS[kind, field]))
    assert report_of("repair", source, "-o", targets[1])[0] == 0
    assert targets[1].read_bytes() == targets[0].read_bytes()


def test_an_index_that_disagrees_is_reported_once(tmp_path: Path) -> None:
    """Each of its chunks describes the connection."""
    source = uncovered(tmp_path, "bag", 20)
    changed(source, *DESCRIBED["definition"], last=True)
    _, stderr, report = report_of("repair", source, "-o", tmp_path / "out.bag")
    assert lost(report) == [0]
    assert stderr.count("the index and the content disagree") == 1


def test_a_connection_that_only_chunks_describe(tmp_path: Path) -> None:
    connections = [replace(connection("/a"), id=0), replace(connection("/b"), id=1)]
    rows = [(n % 2, T0 + n, string_of(f"hello {n}")) for n in range(20)]
    source = write_bag(tmp_path / "drive.bag", connections, rows, "none", chunk_size=300)
    data = bytearray(source.read_bytes())
    # Its id in the index.
    data[data.rindex(b"conn=", 0, data.rindex(b"topic=/b")) + 5] = 9
    source.write_bytes(data)
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "fixed.bag")
    assert status == 3
    assert "connection 1 has messages, and only chunks describe it" in stderr
    assert len(rows_of(tmp_path / "fixed.bag")) == 20


def test_a_chunk_with_another_connection_is_not_copied_whole(tmp_path: Path) -> None:
    """What is damaged in the source is not damaged in its copy."""
    source = changed(write_rosbag1(tmp_path / "drive.bag", large(1, T0, T0 + 1, T0 + 2)), *DESCRIBED["type"])
    assert report_of("repair", source, "-o", tmp_path / "fixed.bag")[0] == 3
    assert len(rows_of(tmp_path / "fixed.bag")) == 3


def test_statistics_that_count_only_what_messages_use(tmp_path: Path) -> None:
    """The C++ library lists all channels and schemas, and counts those that have messages."""
    source = sound_mcap(tmp_path)

    def change(statistics: Any) -> None:
        statistics.channel_count = sum(count > 0 for count in statistics.channel_message_counts.values())
        assert statistics.channel_count

    altered_index(source, "Statistics", change)
    assert report_of("repair", source, "-o", tmp_path / "out.mcap")[0] == 0


def test_a_table_that_the_list_of_tables_lost(tmp_path: Path) -> None:
    """The definitions: no other table names them, and messages are read without them."""
    source = write_db3(tmp_path / "drive.db3", drive(1))
    count = len(rows_of(source))
    data = bytearray(source.read_bytes())
    # The first page lists the tables, behind the file's header; here is how many.
    (cells,) = struct.unpack_from(">H", data, 103)
    struct.pack_into(">H", data, 103, cells - 1)
    source.write_bytes(data)
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out")
    assert status == 3
    assert "table sqlite_master contradicts itself" in stderr
    assert len(rows_of(tmp_path / "out")) == count


# --- Log times outside of their chunk's ---


def time_bytes(kind: str, time_ns: int) -> bytes:
    return struct.pack("<II", *divmod(time_ns, SECOND)) if kind == "bag" else struct.pack("<Q", time_ns)


OPTIONS = [("--keep-clouds",), ("--keep-clouds", "--start", "0.1", "--end", "6.5"), ("--only-scans",)]


@pytest.mark.parametrize(
    ("kind", "options", "seconds"), sampled(product(["bag", "mcap"], OPTIONS, [-(10**8), 10**8]), 5)
)
def test_a_log_time_outside_of_its_chunk(kind: str, options: tuple[str, ...], seconds: int, tmp_path: Path) -> None:
    source = uncovered(tmp_path, kind, 20)
    before, after = (tmp_path / f"{name}{source.suffix}" for name in ("before", "after"))
    assert report_of("convert", source, "-o", before, "--min-height", "-1", *options)[0] == 0
    hit = drive(20).of("/points")[30].log_time_ns
    # In the message itself, which comes in front of its index.
    changed(source, time_bytes(kind, hit), time_bytes(kind, hit + seconds * SECOND))
    status, stderr, report = report_of("convert", source, "-o", after, "--min-height", "-1", *options)
    assert status == 3
    assert "a message of log time" in stderr
    assert lost(report) == [0]
    rows = rows_of(after)
    assert sorted(row[::2] for row in rows) == sorted(row[::2] for row in rows_of(before))
    # It has the nearest time of its chunk.
    times = [row[1] for row in rows]
    assert max(abs(time - T0) for time in times) < 9 * SECOND
    assert times == sorted(times)


def test_times_of_several_messages_are_not_bent(tmp_path: Path) -> None:
    """Where many lie outside, in order, it is the declared times that are wrong."""
    source = uncovered(tmp_path, "bag", 20)
    sound = rows_of(source)
    bent(source, 5, "start_time", lambda first, last: (first + last) // 2)
    assert read(source) == sound
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out.bag")
    assert status == 3
    assert "has a message of log time" in stderr
    assert rows_of(tmp_path / "out.bag") == sound


# --- Times of chunks that hide messages from a cut ---


def bent(source: Path, number: int, field: str, bend: Callable[[int, int], int]) -> tuple[int, int]:
    """Change a log time that is declared of the n-th chunk; returns the old one and the new one.

    By the index; without one, by the chunk itself. ``bend`` takes the first log time and the last one.
    """
    bag = source.suffix == ".bag"
    record = next(r for r in ("chunk_info", "chunk_index", "chunk") if fields_of(source, f"{r}.start_time"))
    places = {name: fields_of(source, f"{record}.{name}")[number].start for name in ("start_time", "end_time")}
    data = bytearray(source.read_bytes())
    found = (struct.unpack_from("<II" if bag else "<Q", data, place) for place in places.values())
    first, last = (time[0] * SECOND + time[1] if bag else time[0] for time in found)
    new = bend(first, last)
    data[places[field] : places[field] + 8] = time_bytes("bag" if bag else "mcap", new)
    source.write_bytes(data)
    return first if field == "start_time" else last, new


#: What becomes of the chunk's first and last time: the field, and its new value.
BENDS: dict[str, tuple[str, Callable[[int, int], int]]] = {
    "start behind the end": ("start_time", lambda _, last: last + 5 * SECOND),
    "start within the chunk": ("start_time", lambda first, last: (first + 3 * last) // 4),
    "end in front of the start": ("end_time", lambda first, _: first - 5 * SECOND),
    "end within the chunk": ("end_time", lambda first, last: (3 * first + last) // 4),
    "start long ago": ("start_time", lambda first, _: first - 10**8 * SECOND),
}
BENT = list(product(["bag", "mcap", "mcap without a summary"], BENDS, [0, 10, -1]))


@pytest.mark.parametrize(("kind", "bend", "number"), sampled(BENT, 11))
def test_a_cut_finds_messages_whose_chunk_has_a_wrong_time(kind: str, bend: str, number: int, tmp_path: Path) -> None:
    source = uncovered(tmp_path, kind, 20)
    if kind == "mcap without a summary":
        source = without_summary(source, tmp_path / "drive.mcap")
    sound = tmp_path / f"sound{source.suffix}"
    sound.write_bytes(source.read_bytes())
    old, new = bent(source, number, *BENDS[bend])
    # Cuts that end, or begin, between the true time and the one that is declared; and the same from the beginning on.
    middle = (max(old, T0) + min(max(new, T0), T0 + 9 * SECOND)) // 2
    cuts = [(None, (middle - T0) / SECOND), ((middle - T0) / SECOND, None), (0.2, 4.1)]
    reported = []
    for start, end in cuts:
        expected, _ = cut_of(sound, start, end)
        found, damage = cut_of(source, start, end)
        assert found == expected, (start, end)
        reported.append(damage)
    # A time that is too early for a chunk in the middle hides nothing.
    assert any(reported) or old == new or (bend == "start long ago" and number != 0)


def without_summary(source: Path, target: Path) -> Path:
    data = source.read_bytes()
    position, opcode = 8, 0
    while opcode != 0x0F:
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9 + length
    target.write_bytes(data[:position] + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + data[:8])
    return target


def cut_of(path: Path, start: float | None, end: float | None) -> tuple[list[Row], bool]:
    """What a cut passes on, and whether damage is reported."""
    with TemporaryDirectory() as folder:
        target = Path(folder, f"out{path.suffix}")
        bounds: dict[str, Any] = {
            name: f"{time:.9f}" for name, time in (("start", start), ("end", end)) if time is not None
        }
        try:
            report = pc2scan.convert(
                path, target, params=pc2scan.ProjectionParams(min_height=-1.0), keep_clouds=True, **bounds
            )
        except (ResultError, UsageError):
            # No cloud is in the cut; what else is there can be read.
            with closing(open_recording(path)) as reader:
                begin_ns = reader.summary.start_ns or 0
                cut = [None if time is None else begin_ns + round(time * SECOND) for time in (start, end)]
                rows = [
                    (m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages(None, cut[0], cut[1])
                ]
                return rows, bool(reader.damage)
        for damage in report.damage:
            assert "of log time" in damage.what or (
                "the index and the content disagree: it has log times" in damage.what and damage.messages_lost == 0
            )
        return rows_of(target), bool(report.damage)


# --- Recordings that follow each other in one file ---


def joined(tmp_path: Path, kind: str, share: float = 1) -> tuple[Path, list[list[Row]], int]:
    """Write what ``cat a b`` makes of two recordings, of the first of which there is a share.

    Returns the file, the messages of each, and where the second one begins. Its ids mean other topics, and it is later.
    """
    first = drive(3)
    later = [replace(item, log_time_ns=item.log_time_ns + 100 * SECOND) for item in first.items]
    parts, rows = [], []
    suffix = "bag" if kind.startswith("bag") else "mcap"
    for number, recording in enumerate((first, Recording(first.streams[::-1], tuple(later)))):
        path = tmp_path / f"{number}.{suffix}"
        if suffix == "bag":
            write_rosbag1(path, recording, kind.partition("-")[2], chunk_size=5_000)
        else:
            write_mcap(path, recording, Mcap(compression="lz4"))
            if kind.endswith("without a summary"):
                without_summary(path, path)
        rows.append(rows_of(path))
        parts.append(path.read_bytes())
    place = int(len(parts[0]) * share)
    target = tmp_path / f"both.{suffix}"
    target.write_bytes(parts[0][:place] + parts[1])
    return target, rows, place


KINDS = ("bag-none", "bag-lz4", "mcap", "mcap without a summary")


@pytest.mark.parametrize("more", [0, 0.25, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_a_second_recording_in_a_file_is_reported_and_not_read(kind: str, more: float, tmp_path: Path) -> None:
    """Nor is a third one, of which there may be a part."""
    source, (first, second), place = joined(tmp_path, kind)
    both = source.read_bytes()
    source.write_bytes(both + both[: int(place * more)])
    target = tmp_path / f"fixed{source.suffix}"
    status, stderr, report = report_of("repair", source, "-o", target)
    assert status == 3
    (damage,) = report["damage"]
    assert (damage["offset"], damage["bytes_lost"]) == (place, source.stat().st_size - place)
    assert f"another recording begins at byte {place} and is not read: tail -c +{place + 1} makes a file" in stderr
    assert rows_of(target) == first
    assert run("convert", source, "-o", tmp_path / "strict.mcap", "--strict").status == 1
    assert f"{len(first)} messages" in run("info", source).stdout
    if not more:
        rest = tmp_path / f"rest{source.suffix}"
        rest.write_bytes(both[place:])
        assert rows_of(rest) == second


@pytest.mark.parametrize(("kind", "share"), sampled(product(KINDS, [0.5, 0.9, 0.99]), 5))
def test_a_second_recording_ends_the_first_that_is_cut(kind: str, share: float, tmp_path: Path) -> None:
    source, (first, _), place = joined(tmp_path, kind, share)
    with closing(open_recording(source)) as reader:
        found = [(message.connection.topic, message.log_time_ns, bytes(message.data)) for message in reader.messages()]
        assert any(damage.what.startswith(f"another recording begins at byte {place}") for damage in reader.damage)
    # The library describes connections at the end of a bag only.
    assert found or (kind.startswith("bag") and share < 0.9)
    assert set(found) <= set(first)


def test_a_recording_in_a_message_is_no_second_recording(tmp_path: Path) -> None:
    """Bags are sent around in messages, too."""
    inner = write_rosbag1(tmp_path / "inner.bag", drive(1)).read_bytes().decode("latin-1")
    items = [Item(CHATTER, T0 + n, {1: string(inner, 1)}) for n in range(3)]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((CHATTER,), tuple(items)))
    assert report_of("repair", source, "-o", tmp_path / "fixed.bag")[0] == 0
    assert len(rows_of(tmp_path / "fixed.bag")) == 3


@pytest.mark.parametrize("kind", ["bag", "mcap", "mcap without chunks"])
def test_a_recording_in_a_message_does_not_end_a_damaged_file(kind: str, tmp_path: Path) -> None:
    """The recording's own index follows."""
    suffix, version = ("bag", 1) if kind == "bag" else ("mcap", 2)
    inner = tmp_path / f"inner.{suffix}"
    form = Mcap(compression="none", chunked=kind == "mcap")
    write_rosbag1(inner, drive(1)) if suffix == "bag" else write_mcap(inner, drive(1), form)
    text = inner.read_bytes().decode("latin-1")
    items = tuple(Item(CHATTER, T0 + n, {version: string(text, version)}) for n in range(9))
    source, recording = tmp_path / f"drive.{suffix}", Recording((CHATTER,), items)
    write_rosbag1(source, recording, "none") if suffix == "bag" else write_mcap(source, recording, form)
    sound = rows_of(source)
    data = source.read_bytes()
    if suffix == "bag":
        begins = [record.start for record in raw_records(data, len(FIRST_LINE), len(data))]
    else:
        begins = [start for _, start, _ in mcap_records(data, 8, len(data) - 8)]
    # The records' lengths and kinds, behind the header.
    for place in (begin + step for begin in begins[1:] for step in range(9)):
        source.write_bytes(data[:place] + bytes([data[place] ^ 0x40]) + data[place + 1 :])
        with closing(open_recording(source)) as reader:
            assert len(list(reader.messages())) >= len(sound) - 1, place
            assert not [damage.what for damage in reader.damage if "another recording" in damage.what]


# --- The CRC of an MCAP file's data section ---


@pytest.mark.parametrize("command", [("repair",), ("convert", "--min-height", "-1"), ("convert", "--jobs", "1")])
def test_the_crc_of_a_data_section_without_chunks(command: tuple[str, ...], tmp_path: Path) -> None:
    # Large enough for several stretches, and with other records between the messages.
    long = [Item(CHATTER, T0 + 20 * SECOND + n, {2: string("a" * 900_000, 2)}) for n in range(12)]
    recording = drive(2)
    form = Mcap(chunked=False, data_crc=True, attachments=[("map.pgm", "image/x", 7, 8, b"P5 1 1 255 x" * 5)])
    source = write_mcap(tmp_path / "drive.mcap", replace(recording, items=(*recording.items, *long)), form)
    target = tmp_path / "out.mcap"
    words: list[str | Path] = [command[0], source, "-o", target, "--overwrite", *command[1:]]
    status, stderr, _ = report_of(*words)
    assert (status, "damaged" in stderr) == (0, False)
    sound = len(rows_of(target))
    data = source.read_bytes()
    hello = data.index(b"hello 1\0")
    for place in (data.index(b"map.pgm") + 40, hello, hello + 4_000_000):
        source.write_bytes(data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :])
        status, stderr, report = report_of(*words)
        assert status == 3
        assert "the data section has CRC" in stderr
        assert [damage["messages_lost"] for damage in report["damage"] if "data section" in damage["what"]] == [0]
        assert len(rows_of(target)) == sound
    strict = run("convert", source, "-o", tmp_path / "strict.mcap", "--strict")
    assert strict.status == 1
    assert "the data section has CRC" in strict.stderr


@needs_shared
def test_the_flipped_bit_of_the_shared_file(tmp_path: Path) -> None:
    status, stderr, _ = report_of("repair", SHARED / "hostile" / "dc.mcap", "-o", tmp_path / "out.mcap")
    assert (status, "the data section has CRC" in stderr) == (3, True)


def test_memory_that_runs_out_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Compressor:
        def __init__(self, *, level: int) -> None:
            pass

        def compress(self, _: bytes) -> bytes:
            raise zstandard.ZstdError("cannot compress: Allocation error : not enough memory")

    monkeypatch.setattr(zstandard, "ZstdCompressor", Compressor)
    done = run("convert", ROOT / "fixtures" / "hall.mcap", "-o", tmp_path / "out.mcap", "--min-height", "0.1")
    assert (done.status, "Traceback" in done.stderr) == (1, False)
    assert "error: memory ran out: " in done.stderr
    assert "\nhint: fewer threads take less: --jobs 1\n" in done.stderr
    assert list(tmp_path.iterdir()) == []
