"""Losses that the format shows: each is reported with its place, and nothing else of the recording is lost."""

from __future__ import annotations

import json
import re
import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import pytest
from mcap.writer import Writer as McapLibraryWriter

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.errors import ResultError, UsageError
from support import SHARED, needs_shared
from support.builders import (
    CHATTER,
    CONTENT,
    POINTS,
    SECOND,
    T0,
    Mcap,
    Recording,
    metadata_yaml,
    string,
    write_db3,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)
from support.command import run
from support.mcap_files import altered_index, library_file
from support.rosbag1_files import connection
from support.rosbag1_files import string as string_of
from support.rosbag1_files import write as write_bag

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mcap.records import Statistics

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

Row = tuple[str, int, bytes]


def rows_of(path: Path) -> list[Row]:
    """Every message: topic, log time and data."""
    with closing(open_recording(path)) as reader:
        rows = [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()]
        assert not reader.damage
        return rows


def report_of(*command: str | Path) -> tuple[int, str, dict[str, Any]]:
    """Exit status, standard error, and the report of a run."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "report.json")
        done = run(*command, "--quiet", "--report", path)
        assert "Traceback" not in done.stderr
        assert path.exists(), done.stderr
        return done.status, done.stderr, json.loads(path.read_text())


# --- Serialisations that nothing decodes ---

#: Bytes that are no CDR, among them what other readers take for compressed or empty messages.
PAYLOADS = (b"", b"\0", b"{}", ZSTD_MAGIC, ZSTD_MAGIC + b"no frame", bytes(range(256)), b"\xff" * 70_000)


def foreign_db3(path: Path, formats: Iterable[str]) -> list[Row]:
    """A ``.db3`` with a topic in each serialisation format and one in CDR; returns what is in it."""
    write_db3(path, Recording((CHATTER,), tuple(CONTENT.of("/chatter"))))
    rows = [("/chatter", item.log_time_ns, item.data[2]) for item in CONTENT.of("/chatter")]
    with closing(sqlite3.connect(path)) as database, database:
        # The first message decides nothing about the others.
        for number, name in enumerate(formats):
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


def foreign_mcap(path: Path, formats: Iterable[str], *, chunked: bool = True) -> list[Row]:
    rows = []
    with path.open("wb") as file:
        writer = McapLibraryWriter(file, chunk_size=1000, use_chunking=chunked)
        writer.start("", "tests")
        for number, name in enumerate(formats):
            channel = writer.register_channel(f"/foreign{number}", name, 0, {})
            for step, data in enumerate(PAYLOADS):
                rows.append((f"/foreign{number}", T0 + 1000 * number + step, data))
                writer.add_message(channel, rows[-1][1], data, rows[-1][1])
        writer.finish()  # type: ignore[no-untyped-call]
    return rows


FORMATS = ("", "wrong_format", "json", "ros1")


def test_repair_of_a_db3_keeps_every_serialisation(tmp_path: Path) -> None:
    rows = foreign_db3(tmp_path / "drive.db3", FORMATS)
    status, stderr, report = report_of("repair", tmp_path / "drive.db3")
    assert (status, stderr) == (0, "")
    assert rows_of(tmp_path / "drive_repaired") == rows
    assert report["messages_read"] == len(rows)
    with closing(sqlite3.connect(tmp_path / "drive_repaired" / "drive_repaired_0.db3")) as database:
        formats = database.execute("SELECT serialization_format FROM topics ORDER BY id").fetchall()
        assert formats == [("cdr",), *((name,) for name in FORMATS)]
        stored = database.execute("SELECT data FROM messages ORDER BY timestamp, id").fetchall()
        assert [data for (data,) in stored] == [data for _, _, data in rows]


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_rosbag2_directory_keeps_every_serialisation(storage: str, tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    if storage == "sqlite3":
        rows = foreign_db3(folder / "drive_0.db3", FORMATS)
    else:
        rows = foreign_mcap(folder / "drive_0.mcap", FORMATS)
    status, stderr, _ = report_of("repair", folder, "-o", tmp_path / "fixed")
    assert (status, stderr) == (0, "")
    assert rows_of(tmp_path / "fixed") == rows


@pytest.mark.parametrize("chunked", [True, False])
def test_repair_of_an_mcap_file_keeps_every_serialisation(chunked: bool, tmp_path: Path) -> None:
    rows = foreign_mcap(tmp_path / "drive.mcap", (*FORMATS, "cbor"), chunked=chunked)
    for number, options in enumerate(([], ["--no-verify"], ["--compression", "lz4"])):
        target = tmp_path / f"fixed{number}.mcap"
        status, stderr, _ = report_of("repair", tmp_path / "drive.mcap", "-o", target, *options)
        assert (status, stderr) == (0, "")
        assert rows_of(target) == rows


def test_a_conversion_passes_on_what_no_one_decodes(tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT)
    with closing(sqlite3.connect(source / "drive_0.db3")) as database, database:
        database.execute("UPDATE topics SET serialization_format = 'wrong_format' WHERE name = '/chatter'")
    path = source / "metadata.yaml"
    at = (text := path.read_text()).index("serialization_format: cdr", text.index("name: /chatter"))
    path.write_text(text[:at] + "serialization_format: wrong_format" + text[at + 25 :])
    status, _, report = report_of("convert", source, "-o", tmp_path / "out", "--min-height", "-1")
    assert status == 0
    assert {t["topic"]: t["action"] for t in report["topics"]}["/chatter"] == "passed"
    expected = [item.data[2] for item in CONTENT.of("/chatter")]
    assert [data for topic, _, data in rows_of(tmp_path / "out") if topic == "/chatter"] == expected


@pytest.mark.parametrize("mode", ["", "file", "message"])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_an_empty_storage_identifier_is_found_out_from_the_files(storage: str, mode: str, tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT, storage=storage, mode=mode)
    rows = rows_of(source)
    path = source / "metadata.yaml"
    path.write_text(re.sub(r"storage_identifier: \w+", 'storage_identifier: ""', path.read_text()))
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "fixed")
    assert (status, stderr) == (0, "")
    assert rows_of(tmp_path / "fixed") == rows
    with closing(open_recording(tmp_path / "fixed")) as reader:
        assert reader.summary.storage == storage


def test_an_empty_storage_identifier_of_files_that_are_not_there(tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", CONTENT)
    text = metadata_yaml("drive", CONTENT, ["gone_0.bin"], storage='""', version=8, mode="")
    (source / "metadata.yaml").write_text(text)
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "fixed")
    assert status == 3
    assert "no file shows which storage it is" in stderr
    assert len(rows_of(tmp_path / "fixed")) == len(CONTENT.items)


# --- Log times that a container cannot hold ---


def with_times(times: Iterable[int]) -> Recording:
    """A message of /chatter at each of these times, and the clouds of the usual content."""
    from support.builders import Item

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
    recording = with_times([T0, time_ns, T0 + 5])
    if kind == "db3":
        source = write_db3(tmp_path / "drive.db3", recording)
    else:
        source = write_mcap(tmp_path / "drive.mcap", recording)
    options: list[str] = []
    if command == "convert":
        options = ["--min-height", "-1", "--keep-clouds", "--static-tf", "base lidar 0 0 1 0 0 0", "--write-static-tf"]
    if "." not in name:
        options += ["--storage", "sqlite3" if "database" in case else "mcap"]
    status, stderr, report = report_of(command, source, "-o", tmp_path / name, *options)
    assert status == 3, stderr
    assert report["skipped_count"] == 1
    (skipped,) = report["skipped"]
    assert (skipped["topic"], skipped["log_time_ns"]) == ("/chatter", time_ns)
    assert str(time_ns) in skipped["reason"]
    assert f"skipped: /chatter, stamp unknown: log time {time_ns} ns" in stderr
    (chatter,) = [topic for topic in report["topics"] if topic["topic"] == "/chatter"]
    assert (chatter["messages_in"], chatter["messages_out"], chatter["skipped"]) == (3, 2, 1)
    written = [row for row in rows_of(tmp_path / name) if row[0] == "/chatter"]
    assert [row[1] for row in written] == [T0, T0 + 5]


def test_a_chunk_with_a_log_time_that_rosbag2_cannot_hold_is_not_copied_whole(tmp_path: Path) -> None:
    from support.builders import Item

    large = [Item(CHATTER, t, {2: string("a" * 400_000, 2)}) for t in (T0, T0 + 1, 2**63 + 5)]
    source = write_mcap(tmp_path / "drive.mcap", Recording((CHATTER,), tuple(large)))
    status, _, report = report_of("repair", source, "-o", tmp_path / "out")
    assert (status, report["skipped_count"]) == (3, 1)
    text = (tmp_path / "out" / "metadata.yaml").read_text()
    assert str(T0) in text
    assert "message_count: 2" in text


def test_fail_stops_at_a_log_time_that_the_container_cannot_hold(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "drive.mcap", with_times([T0, 2**32 * SECOND]))
    done = run("convert", source, "-o", tmp_path / "out.bag", "--on-error", "fail")
    assert done.status == 1
    assert "is outside the 0 to 4294967295 s" in done.stderr
    assert not (tmp_path / "out.bag").exists()


# --- What a recording says twice ---


def drive(times: int = 20) -> Recording:
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


def everything(path: Path) -> list[Row]:
    """Messages by log time, whatever is damaged."""
    with closing(open_recording(path)) as reader:
        return [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages()]


DESCRIBED = {
    "topic": (b"topic=/chatter", b"topic=/chattes"),
    "type": (b"type=std_msgs/String", b"type=std_msgs/Strinh"),
    "definition": (b"# Charge of the pack", b"# Charge of the sack"),
    "md5sum": (b"md5sum=992ce8a1687cec8c8bd883ec73ca41d1", b"md5sum=992ce8a1687cec8c8bd883ec73ca41d2"),
}


@pytest.mark.parametrize("last", [False, True], ids=["in a chunk", "in the index"])
@pytest.mark.parametrize("what", DESCRIBED)
def test_a_connection_that_a_chunk_describes_otherwise(what: str, last: bool, tmp_path: Path) -> None:
    source = write_rosbag1(tmp_path / "drive.bag", drive(3), chunk_size=5_000)
    sound = everything(source)
    changed(source, *DESCRIBED[what], last=last)
    status, stderr, report = report_of("repair", source, "-o", tmp_path / "fixed.bag")
    assert status == 3
    assert "contradicts the index: connection" in stderr
    assert "no message is known to be missing" in stderr
    assert [damage["messages_lost"] for damage in report["damage"]] == [0]
    assert [row[1:] for row in rows_of(tmp_path / "fixed.bag")] == [row[1:] for row in sound]
    strict = run("convert", source, "-o", tmp_path / "strict.bag", "--strict")
    assert (strict.status, (tmp_path / "strict.bag").exists()) == (1, False)


def test_a_connection_that_only_chunks_describe(tmp_path: Path) -> None:
    connections = [replace(connection("/a"), id=0), replace(connection("/b"), id=1)]
    rows = [(n % 2, T0 + n, string_of(f"hello {n}")) for n in range(20)]
    source = write_bag(tmp_path / "drive.bag", connections, rows, "none", chunk_size=300)
    data = bytearray(source.read_bytes())
    # Its id in the index.
    at = data.rindex(b"conn=", 0, data.rindex(b"topic=/b"))
    data[at + 5] = 9
    source.write_bytes(data)
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "fixed.bag")
    assert status == 3
    assert "connection 1 has messages, and only chunks describe it" in stderr
    assert len(rows_of(tmp_path / "fixed.bag")) == 20


@pytest.mark.parametrize("verify", [True, False])
def test_a_chunk_with_another_connection_is_not_copied_whole(verify: bool, tmp_path: Path) -> None:
    """What is damaged in the source is not damaged in its copy."""
    from support.builders import Item

    large = [Item(CHATTER, T0 + n, {1: string("a" * 400_000, 1)}) for n in range(3)]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((CHATTER,), tuple(large)))
    changed(source, *DESCRIBED["type"])
    options = [] if verify else ["--no-verify"]
    status, _, _ = report_of("repair", source, "-o", tmp_path / "fixed.bag", *options)
    assert status == 3
    assert len(rows_of(tmp_path / "fixed.bag")) == 3


@pytest.mark.parametrize("part", ["summary", "data", "chunk"])
def test_an_mcap_channel_that_is_declared_otherwise(part: str, tmp_path: Path) -> None:
    # The library declares channels within the chunks, and again in the summary.
    source = write_mcap(tmp_path / "drive.mcap", drive(3), Mcap(compression="none", crcs=False, chunked=part != "data"))
    rows = everything(source)
    changed(source, b"/chatter", b"/chattes", last=part == "summary")
    status, stderr, report = report_of("repair", source, "-o", tmp_path / "fixed.mcap")
    assert status == 3
    assert re.search(r"channel \d+ is declared again, and differently", stderr)
    assert [damage["messages_lost"] for damage in report["damage"]] == [0]
    assert [row[1:] for row in rows_of(tmp_path / "fixed.mcap")] == [row[1:] for row in rows]


# --- Log times outside of their chunk's ---


def uncovered(tmp_path: Path, kind: str, recording: Recording) -> Path:
    """A recording in many chunks without compression, and without checksums of the messages and of the index."""
    if kind == "bag":
        return write_rosbag1(tmp_path / "drive.bag", recording, chunk_size=5_000)
    return write_mcap(tmp_path / "drive.mcap", recording, Mcap(compression="none", crcs=False))


def time_bytes(kind: str, time_ns: int) -> bytes:
    return struct.pack("<II", *divmod(time_ns, SECOND)) if kind == "bag" else struct.pack("<Q", time_ns)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize("options", [(), ("--start", "0.1", "--end", "6.5"), ("--only-scans",)], ids=" ".join)
@pytest.mark.parametrize("seconds", [-(10**8), 10**8])
def test_a_log_time_outside_of_its_chunk(options: tuple[str, ...], kind: str, seconds: int, tmp_path: Path) -> None:
    recording = drive()
    source = uncovered(tmp_path, kind, recording)
    arguments = ("--min-height", "-1", "--keep-clouds", *options)
    arguments = tuple(a for a in arguments if "--only-scans" not in options or a != "--keep-clouds")
    suffix = source.suffix
    status, _, _ = report_of("convert", source, "-o", tmp_path / f"sound{suffix}", *arguments)
    assert status == 0
    hit = recording.of("/points")[30].log_time_ns
    # In the message itself, which comes in front of its index.
    changed(source, time_bytes(kind, hit), time_bytes(kind, hit + seconds * SECOND))
    status, stderr, report = report_of("convert", source, "-o", tmp_path / f"out{suffix}", *arguments)
    assert status == 3
    assert "a message of log time" in stderr
    assert [damage["messages_lost"] for damage in report["damage"]] == [0]
    before, after = rows_of(tmp_path / f"sound{suffix}"), rows_of(tmp_path / f"out{suffix}")
    assert sorted(row[::2] for row in after) == sorted(row[::2] for row in before)
    # It has the nearest time of its chunk.
    assert max(abs(row[1] - T0) for row in after) < 9 * SECOND
    times = [row[1] for row in after]
    assert times == sorted(times)


def test_times_of_several_messages_are_not_bent(tmp_path: Path) -> None:
    """Where many lie outside, in order, it is the declared times that are wrong."""
    recording = drive()
    source = uncovered(tmp_path, "bag", recording)
    sound = everything(source)
    changes = bent(source, 5, "start_time", lambda first, last: (first + last) // 2)
    assert changes
    assert everything(source) == sound
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out.bag")
    assert status == 3
    assert "has a message of log time" in stderr
    assert rows_of(tmp_path / "out.bag") == sound


# --- Times of chunks that hide messages from a cut ---


def bent(source: Path, number: int, field: str, bend: Callable[[int, int], int]) -> tuple[int, int]:
    """Change a time that the index declares of the n-th chunk; returns the old one and the new one."""
    data = bytearray(source.read_bytes())
    if source.suffix == ".bag":
        infos = [m.start() for m in re.finditer(rb"\x13\0\0\0start_time=", data)]
        found = [
            tuple(data.index(name, at - 60) + len(name) for name in (b"start_time=", b"end_time=")) for at in infos
        ]
        start, end = sorted(found, key=lambda places: places)[number]

        def time_at(at: int) -> int:
            seconds, nanoseconds = struct.unpack_from("<II", data, at)
            return int(seconds * SECOND + nanoseconds)

    else:
        start, end = chunk_times(bytes(data))[number]

        def time_at(at: int) -> int:
            return int(struct.unpack_from("<Q", data, at)[0])

    at = start if field == "start_time" else end
    old, new = time_at(at), bend(time_at(start), time_at(end))
    data[at : at + 8] = time_bytes("bag" if source.suffix == ".bag" else "mcap", new)
    source.write_bytes(data)
    return old, new


def chunk_times(data: bytes) -> list[tuple[int, int]]:
    """Where the summary of an MCAP file declares the times of its chunks; without one, where their headers do."""
    found: dict[int, list[tuple[int, int]]] = {6: [], 8: []}
    position = 8
    while position < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, position)
        if opcode in found:
            found[opcode].append((position + 9, position + 17))
        position += 9 + length
    return found[8] or found[6]


#: What becomes of the chunk's first and last time: the field, and its new value.
BENDS: dict[str, tuple[str, Callable[[int, int], int]]] = {
    "start behind the end": ("start_time", lambda _, last: last + 5 * SECOND),
    "start within the chunk": ("start_time", lambda first, last: (first + 3 * last) // 4),
    "end in front of the start": ("end_time", lambda first, _: first - 5 * SECOND),
    "end within the chunk": ("end_time", lambda first, last: (3 * first + last) // 4),
    "start long ago": ("start_time", lambda first, _: first - 10**8 * SECOND),
}


@pytest.mark.parametrize("number", [0, 10, -1])
@pytest.mark.parametrize("bend", BENDS)
@pytest.mark.parametrize("kind", ["bag", "mcap", "mcap without a summary"])
def test_a_cut_finds_messages_whose_chunk_has_a_wrong_time(kind: str, bend: str, number: int, tmp_path: Path) -> None:
    recording = drive()
    if kind == "mcap without a summary":
        source = write_mcap(tmp_path / "full.mcap", recording, Mcap(compression="none", crcs=False))
        source = without_summary(source, tmp_path / "drive.mcap")
    else:
        source = uncovered(tmp_path, kind, recording)
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
    position = 8
    while True:
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9 + length
        if opcode == 0x0F:
            break
    target.write_bytes(data[:position] + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + data[:8])
    return target


def cut_of(path: Path, start: float | None, end: float | None) -> tuple[list[Row], bool]:
    """What a cut passes on, and whether damage is reported."""
    with TemporaryDirectory() as folder:
        target = Path(folder, f"out{path.suffix}")
        try:
            report = pc2scan.convert(
                path,
                target,
                params=pc2scan.ProjectionParams(min_height=-1.0),
                keep_clouds=True,
                start=None if start is None else f"{start:.9f}",
                end=None if end is None else f"{end:.9f}",
            )
        except (ResultError, UsageError):
            # No cloud is in the cut; what else is there can be read.
            with closing(open_recording(path)) as reader:
                begin_ns = reader.summary.start_ns or 0
                cut = [None if time is None else begin_ns + round(time * SECOND) for time in (start, end)]
                rows = [(m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages(None, *cut)]
                return rows, bool(reader.damage)
        return rows_of(target), bool(report.damage)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_cut_reports_a_wrong_time(kind: str, tmp_path: Path) -> None:
    """The same by the real command."""
    source = uncovered(tmp_path, kind, drive())
    options = ("--min-height", "-1", "--end", "3.9")
    status, _, _ = report_of("convert", source, "-o", tmp_path / f"sound{source.suffix}", *options)
    assert status == 0
    for number in range(6, 14):
        bent(source, number, "start_time", lambda _, last: last + 5 * SECOND)
    status, stderr, report = report_of("convert", source, "-o", tmp_path / f"out{source.suffix}", *options)
    assert status == 3
    assert "the index has log times" in stderr
    assert {damage["messages_lost"] for damage in report["damage"]} == {0}
    assert rows_of(tmp_path / f"out{source.suffix}") == rows_of(tmp_path / f"sound{source.suffix}")


# --- Counts ---


def test_a_message_of_another_connection_is_found_by_the_counts(tmp_path: Path) -> None:
    """Its connection's id is another one that there is: only the counts by connection tell."""
    source = write_rosbag1(tmp_path / "drive.bag", drive(3), chunk_size=5_000)
    data = bytearray(source.read_bytes())
    with closing(open_recording(source)) as reader:
        ids = {connection.topic: connection.id for connection in reader.connections}
    field = b"\x09\0\0\0conn=" + struct.pack("<I", ids["/chatter"])
    # Of the records with this field the messages alone have a time, too.
    places = (match.end() for match in re.finditer(re.escape(field), data))
    at = next(at for at in places if b"\x0d\0\0\0time=" in data[at - 50 : at + 50])
    data[at - 4] = ids["/imu"]
    source.write_bytes(data)
    status, stderr, report = report_of("repair", source, "-o", tmp_path / "out.bag")
    assert status == 3
    assert "51 messages, 51 were found" in stderr
    assert "/chatter: 9 declared, 8 found" in stderr
    assert "/imu: 9 declared, 10 found" in stderr
    # The index behind the chunk contradicts it too, which costs nothing.
    assert sorted(damage["messages_lost"] for damage in report["damage"]) == [0, 1]


def test_a_message_of_another_channel_is_found_by_the_statistics(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "drive.mcap", drive(3), Mcap(compression="none", crcs=False))
    with closing(open_recording(source)) as reader:
        ids = {connection.topic: connection.id for connection in reader.connections}
        message = next(m for m in reader.messages() if m.connection.topic == "/chatter")
        before = struct.pack("<HI", ids["/chatter"], message.sequence) + struct.pack("<Q", message.log_time_ns)
    changed(source, before, struct.pack("<H", ids["/imu"]) + before[2:])
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out.mcap")
    assert status == 3
    assert "/chatter: 9 declared, 8 found; /imu: 9 declared, 10 found" in stderr


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("message_start_time", T0 + SECOND, "the statistics have log times"),
        ("message_end_time", T0 + 1, "the statistics have log times"),
        ("channel_count", 90, "the statistics count 90 channels"),
        ("channel_count", 1, "the statistics count 1 channels"),
        ("schema_count", 90, "the statistics count 90 schemas"),
        ("schema_count", 1, "the statistics count 1 schemas"),
        ("chunk_count", 90, "the statistics count 90 chunks"),
    ],
)
def test_statistics_that_are_wrong_where_the_crc_is_right(field: str, value: int, words: str, tmp_path: Path) -> None:
    source = write_mcap(tmp_path / "drive.mcap", drive(3))
    rows = rows_of(source)
    altered_index(source, "Statistics", lambda statistics: setattr(statistics, field, value))
    status, stderr, report = report_of("repair", source, "-o", tmp_path / "out.mcap")
    assert status == 3
    assert words in stderr
    assert report["damage"][0]["messages_lost"] == 0
    assert rows_of(tmp_path / "out.mcap") == rows


def test_statistics_that_count_only_what_messages_use(tmp_path: Path) -> None:
    """The C++ library lists all channels and schemas, and counts those that have messages."""
    source = write_mcap(tmp_path / "drive.mcap", drive(3))
    used = 0

    def change(statistics: Statistics) -> None:
        nonlocal used
        used = sum(count > 0 for count in statistics.channel_message_counts.values())
        statistics.channel_count = used

    altered_index(source, "Statistics", change)
    assert used
    assert report_of("repair", source, "-o", tmp_path / "out.mcap")[0] == 0


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("MetadataIndex", "name", "other"),
        ("MetadataIndex", "length", 3),
        ("MetadataIndex", "offset", 9),
        ("AttachmentIndex", "name", "other"),
        ("AttachmentIndex", "media_type", "text/other"),
        ("AttachmentIndex", "data_size", 1),
        ("AttachmentIndex", "length", 3),
        ("AttachmentIndex", "offset", 9),
        ("AttachmentIndex", "log_time", 1),
        ("AttachmentIndex", "create_time", 1),
    ],
)
def test_an_index_of_attachments_and_metadata_that_is_wrong(kind: str, field: str, value: Any, tmp_path: Path) -> None:
    rows = [(number % 2, T0 + number, b"\0\1\0\0") for number in range(9)]
    source = library_file(tmp_path / "drive.mcap", rows, extras=True)
    assert report_of("repair", source, "-o", tmp_path / "before.mcap")[0] == 0
    altered_index(source, kind, lambda index: setattr(index, field, value))
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out.mcap")
    assert status == 3
    assert "the summary" in stderr
    assert (tmp_path / "out.mcap").read_bytes() == (tmp_path / "before.mcap").read_bytes()


def test_more_messages_than_declared(tmp_path: Path) -> None:
    source = write_rosbag1(tmp_path / "drive.bag", drive(1))
    changed(source, struct.pack("<II", 4, 3), struct.pack("<II", 4, 2), last=True)
    status, stderr, report = report_of("repair", source, "-o", tmp_path / "out.bag")
    assert status == 3
    assert "2 declared, 3 found" in stderr
    assert report["damage"][0]["messages_lost"] == 0


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_counts_by_topic_in_metadata_yaml(storage: str, tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", drive(3), storage=storage)
    path = source / "metadata.yaml"
    text = path.read_text()
    at = text.index("message_count: 9", text.index("/chatter"))
    text = text[:at] + "message_count: 8" + text[at + 16 :]
    at = text.index("message_count: 9", text.index("/imu"))
    path.write_text(text[:at] + "message_count: 10" + text[at + 16 :])
    status, stderr, report = report_of("repair", source, "-o", tmp_path / "out")
    assert status == 3
    assert "metadata.yaml counts 51 messages, its files have 51" in stderr
    assert "/chatter: 8 declared, 9 found; /imu: 10 declared, 9 found" in stderr
    assert report["damage"][0]["messages_lost"] == 1


@pytest.mark.parametrize("what", ["type", "serialization_format"])
def test_a_topic_that_metadata_yaml_lists_otherwise(what: str, tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", drive(1))
    rows = rows_of(source)
    path = source / "metadata.yaml"
    text = path.read_text()
    at = text.index(f"{what}: ", text.index("name: /chatter")) + len(what) + 2
    path.write_text(text[:at] + "x" + text[at + 1 :])
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out")
    assert status == 3
    assert "metadata.yaml lists /chatter as" in stderr
    assert rows_of(tmp_path / "out") == rows


def test_a_table_that_the_list_of_tables_lost(tmp_path: Path) -> None:
    """The definitions: no other table names them, and without them other ones would be written."""
    source = write_db3(tmp_path / "drive.db3", drive(1))
    before = definitions_of(source)
    data = bytearray(source.read_bytes())
    # The first page lists the tables, behind the file's header; here is how many.
    (cells,) = struct.unpack_from(">H", data, 103)
    struct.pack_into(">H", data, 103, cells - 1)
    source.write_bytes(data)
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out")
    assert status == 3
    assert "table sqlite_master contradicts itself" in stderr
    assert definitions_of(tmp_path / "out") == before


def definitions_of(path: Path) -> dict[str, bytes]:
    with closing(open_recording(path)) as reader:
        return {connection.topic: connection.definition.data for connection in reader.connections}


def test_a_row_of_another_topic_is_found_by_metadata_yaml(tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / "drive", drive(3))
    with closing(sqlite3.connect(source / "drive_0.db3")) as database, database:
        ids = dict(database.execute("SELECT name, id FROM topics"))
        (row,) = database.execute("SELECT min(id) FROM messages WHERE topic_id = ?", (ids["/chatter"],)).fetchone()
        database.execute("UPDATE messages SET topic_id = ? WHERE id = ?", (ids["/imu"], row))
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out")
    assert status == 3
    assert "/chatter: 9 declared, 8 found; /imu: 9 declared, 10 found" in stderr


# --- Recordings that follow each other in one file ---


def twice(recording: Recording) -> tuple[Recording, Recording]:
    """Two recordings whose ids mean different topics, one after the other in time."""
    later = [replace(item, log_time_ns=item.log_time_ns + 100 * SECOND) for item in recording.items]
    return recording, Recording(recording.streams[::-1], tuple(later))


def joined(tmp_path: Path, kind: str, *, damage: Callable[[bytes], bytes] = bytes) -> tuple[Path, list[Row], int]:
    """What ``cat a b`` makes of two recordings; the messages of both, and where the second one begins."""
    parts, rows = [], []
    for number, recording in enumerate(twice(drive(3))):
        path = tmp_path / f"{number}.{'bag' if kind.startswith('bag') else 'mcap'}"
        if kind.startswith("bag"):
            write_rosbag1(path, recording, kind.partition("-")[2], chunk_size=5_000)
        else:
            write_mcap(path, recording, Mcap(compression="lz4"))
            if kind.endswith("without a summary"):
                without_summary(path, path)
        rows += rows_of(path)
        parts.append(path.read_bytes())
    target = tmp_path / f"both{path.suffix}"
    first = damage(parts[0])
    target.write_bytes(first + parts[1])
    return target, rows, len(first)


KINDS = ("bag-none", "bag-lz4", "mcap", "mcap without a summary")


@pytest.mark.parametrize("kind", KINDS)
def test_both_recordings_of_one_file_are_read(kind: str, tmp_path: Path) -> None:
    source, rows, place = joined(tmp_path, kind)
    status, stderr, report = report_of("repair", source, "-o", tmp_path / f"fixed{source.suffix}")
    assert status == 3
    assert f"byte {place}: another recording begins at byte {place}" in stderr
    assert [damage["messages_lost"] for damage in report["damage"]] == [0]
    assert rows_of(tmp_path / f"fixed{source.suffix}") == rows
    strict = run("convert", source, "-o", tmp_path / "strict.mcap", "--strict")
    assert strict.status == 1
    shown = run("info", source)
    assert f"{len(rows)} messages" in shown.stdout


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
@pytest.mark.parametrize("kind", KINDS)
def test_the_second_recording_is_whole_though_the_first_is_cut(kind: str, share: float, tmp_path: Path) -> None:
    source, rows, _ = joined(tmp_path, kind, damage=lambda data: data[: int(len(data) * share)])
    status, _, _ = report_of("repair", source, "-o", tmp_path / f"fixed{source.suffix}")
    assert status == 3
    found = rows_of(tmp_path / f"fixed{source.suffix}")
    second = [row for row in rows if row[1] > T0 + 50 * SECOND]
    assert [row for row in found if row[1] > T0 + 50 * SECOND] == second
    first = {row for row in found if row[1] < T0 + 50 * SECOND}
    # The library describes connections at the end of a bag only.
    assert first or (kind.startswith("bag") and share < 0.9)
    assert first <= set(rows)


@pytest.mark.parametrize("kind", ["bag-lz4", "mcap"])
def test_three_recordings_of_which_the_last_is_cut(kind: str, tmp_path: Path) -> None:
    source, rows, _ = joined(tmp_path, kind)
    once = source.read_bytes()
    source.write_bytes(once + once[: len(once) // 4])
    status, _, _ = report_of("repair", source, "-o", tmp_path / f"fixed{source.suffix}")
    assert status == 3
    found = rows_of(tmp_path / f"fixed{source.suffix}")
    assert len(found) > len(rows)
    assert set(found) == set(rows)


def test_a_recording_in_a_message_is_no_second_recording(tmp_path: Path) -> None:
    """Bags are sent around in messages, too."""
    from support.builders import Item

    inner = write_rosbag1(tmp_path / "inner.bag", drive(1)).read_bytes().decode("latin-1")
    items = [Item(CHATTER, T0 + n, {1: string(inner, 1)}) for n in range(3)]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((CHATTER,), tuple(items)))
    status, _, _ = report_of("repair", source, "-o", tmp_path / "fixed.bag")
    assert status == 0
    assert len(rows_of(tmp_path / "fixed.bag")) == 3


# --- The CRC of an MCAP file's data section ---


@pytest.mark.parametrize("command", [("repair",), ("convert", "--min-height", "-1"), ("convert", "--jobs", "1")])
def test_the_crc_of_a_data_section_without_chunks(command: tuple[str, ...], tmp_path: Path) -> None:
    # Large enough for several stretches, and with other records between the messages.
    from support.builders import Item

    large = [Item(CHATTER, T0 + 20 * SECOND + n, {2: string("a" * 900_000, 2)}) for n in range(12)]
    recording = drive(2)
    recording = replace(recording, items=(*recording.items, *large))
    form = Mcap(chunked=False, data_crc=True, attachments=[("map.pgm", "image/x", 7, 8, b"P5 1 1 255 x" * 5)])
    source = write_mcap(tmp_path / "drive.mcap", recording, form)
    target = tmp_path / "out.mcap"
    status, stderr, _ = report_of(command[0], source, "-o", target, *command[1:])
    assert (status, "damaged" in stderr) == (0, False)
    sound = rows_of(target)
    data = bytearray(source.read_bytes())
    hello = data.index(b"hello 1\0")
    for place in (data.index(b"map.pgm") + 40, hello, hello + 4_000_000):
        flipped = bytearray(data)
        flipped[place] ^= 0x10
        source.write_bytes(flipped)
        status, stderr, report = report_of(command[0], source, "-o", target, "--overwrite", *command[1:])
        assert status == 3
        assert "the data section has CRC" in stderr
        (found,) = [damage for damage in report["damage"] if "data section" in damage["what"]]
        assert found["messages_lost"] == 0
        assert len(rows_of(target)) == len(sound)
        unverified = report_of(command[0], source, "-o", target, "--overwrite", "--no-verify", *command[1:])
        assert unverified[0] == 0
    strict = run("convert", source, "-o", tmp_path / "strict.mcap", "--strict")
    assert strict.status == 1
    assert "the data section has CRC" in strict.stderr


@needs_shared
def test_the_flipped_bit_of_the_shared_file(tmp_path: Path) -> None:
    source = SHARED / "hostile" / "dc.mcap"
    status, stderr, _ = report_of("repair", source, "-o", tmp_path / "out.mcap")
    assert (status, "the data section has CRC" in stderr) == (3, True)
