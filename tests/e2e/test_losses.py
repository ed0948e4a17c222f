"""Losses that the format shows: each is reported with its place, and nothing else of the recording is lost."""

from __future__ import annotations

import json
import re
import sqlite3
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import pytest
from mcap.writer import Writer as McapLibraryWriter

from builders import (
    CHATTER,
    CONTENT,
    POINTS,
    SECOND,
    T0,
    Recording,
    metadata_yaml,
    string,
    write_db3,
    write_mcap,
    write_rosbag2,
)
from e2e.command import run
from pc2scan.bags.registry import open_recording

if TYPE_CHECKING:
    from collections.abc import Iterable

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
    from builders import Item

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
    from builders import Item

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
