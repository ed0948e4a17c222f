"""The table of formats, and a new container as an entry in it."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

import pc2scan
from pc2scan.bags.formats import FORMATS, Format, ReadOptions, WriteOptions, and_list, destinations, storages
from pc2scan.bags.opening import open_recording
from pc2scan.bags.reader import Reader
from pc2scan.bags.units import Unit
from pc2scan.batch.results import first_part, whole
from pc2scan.cli.app import application
from pc2scan.errors import DestinationError, RecordingError
from pc2scan.model import Connection, Definition, RawMessage, Summary
from pc2scan.options.table import options_of
from support import ROOT

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.model import Attachment, Buffer, ChunkRule, Metadata, StoredChunk
    from pc2scan.threads import Threads

FIXTURES = ROOT / "fixtures"

MAGIC = b"#TOY\n"


class ToyReader(Reader):
    """Lines of JSON: connections, and messages in hexadecimal digits."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._path = path
        self.options = options
        lines = [json.loads(line) for line in path.read_text().splitlines()[1:]]
        self._connections = {
            line["id"]: Connection(
                **{**line, "definition": Definition(line["definition"][0], bytes.fromhex(line["definition"][1]))}
            )
            for line in lines
            if isinstance(line, dict)
        }
        self._messages = [
            RawMessage(self._connections[line[0]], line[1], bytes.fromhex(line[2]), line[1])
            for line in lines
            if isinstance(line, list)
        ]

    path = property(lambda self: self._path)
    connections = property(lambda self: tuple(self._connections.values()))
    bytes_read = property(lambda self: self._path.stat().st_size)

    @property
    def summary(self) -> Summary:
        times = [message.log_time_ns for message in self._messages]
        size = self._path.stat().st_size
        return Summary("toy", "", ("none",), size, len(times), min(times), max(times))

    @property
    def damage(self) -> tuple[Damage, ...]:
        return ()

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterable[Unit]:
        assert rule is None, "there are no chunks to be copied"
        wanted = self._connections if connections is None else {connection.id for connection in connections}
        found = [
            message
            for message in self._messages
            if message.connection.id in wanted
            and (start_ns is None or start_ns <= message.log_time_ns)
            and (stop_ns is None or message.log_time_ns < stop_ns)
        ]

        def load(callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any]:
            assert not whole
            return list(map(callback, found))

        return [Unit(min(m.log_time_ns for m in found), (0,), self.bytes_read, load)] if found else []

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        assert connections
        assert (start_ns or 0) < (stop_ns or 1 << 64)
        return {}

    def close(self) -> None:
        pass


class ToyWriter:
    """Writes what `ToyReader` reads; satisfies `pc2scan.model.Writer`."""

    def __init__(self, path: Path, options: WriteOptions) -> None:
        assert options.compression == "none"
        self._file = path.open("xb")
        self._file.write(MAGIC)
        self._ids = 0

    def _put(self, line: object) -> None:
        self._file.write(json.dumps(line).encode() + b"\n")

    def keep_ids(self, connections: Collection[Connection]) -> None:
        raise AssertionError(f"{connections}: there are no chunks to be copied")

    def add_connection(self, connection: Connection) -> int:
        self._ids += 1
        definition = connection.definition.encoding, connection.definition.data.hex()
        self._put({**asdict(connection), "id": self._ids, "definition": definition, "message_count": None})
        return self._ids

    def declarations(self) -> frozenset[bytes]:
        return frozenset()

    def compress_ahead(self, pool: Threads) -> None:
        pass

    def write(self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0) -> None:
        assert publish_time_ns + sequence >= 0
        self._put([handle, log_time_ns, data.hex()])

    def write_chunk(self, chunk: StoredChunk) -> None:
        raise AssertionError(f"{chunk}: there are no chunks to be copied")

    def add_attachment(self, attachment: Attachment) -> None:
        raise AssertionError(f"{attachment}: it has no place for them")

    def add_metadata(self, metadata: Metadata) -> None:
        raise AssertionError(f"{metadata}: it has no place for them")

    def finish(self) -> None:
        self._file.close()

    def abort(self) -> None:
        self._file.close()


TOY = Format(
    name="toy",
    readable="toys",
    readable_one="toy",
    open_reader=ToyReader,
    open_writer=ToyWriter,
    magic=MAGIC,
    suffix=".toy",
    to="toy",
)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new container needs only an entry in the table."""
    monkeypatch.setitem(FORMATS, "toy", TOY)


def content(path: Path) -> list[tuple[Any, ...]]:
    """The messages of a recording, without what only its container has."""
    with closing(open_recording(path)) as reader:
        return [
            (m.connection.topic, m.connection.ros_type, m.connection.definition, m.log_time_ns, bytes(m.data))
            for m in reader.messages()
        ]


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("source", ["hall", "hall.mcap"])
def test_a_new_container_is_an_entry_and_a_package(tmp_path: Path, source: str, jobs: int) -> None:
    direct, there, back = tmp_path / "direct.mcap", tmp_path / "there.toy", tmp_path / "back.mcap"
    pc2scan.convert(FIXTURES / source, direct, keep_clouds=True, jobs=jobs)
    report = pc2scan.convert(FIXTURES / source, there, keep_clouds=True, jobs=jobs)
    assert report.exit_status == 0
    assert there.read_bytes().startswith(MAGIC)
    expected = content(direct)
    assert len(expected) == 16
    assert content(there) == expected

    # And from it: the clouds are converted again, to other topics.
    pc2scan.convert(there, back, topics=["/points:=/scan2"], keep_clouds=True, jobs=jobs)
    found = content(back)
    assert [entry for entry in found if entry[0] != "/scan2"] == expected
    scans = [entry[-1] for entry in found if entry[0] == "/scan2"]
    assert scans == [entry[-1] for entry in expected if entry[1].endswith("LaserScan")]
    assert scans


@pytest.mark.usefixtures("toy")
def test_a_new_container_has_a_default_destination(tmp_path: Path) -> None:
    source = tmp_path / "a.toy"
    pc2scan.convert(FIXTURES / "hall.mcap", source, keep_clouds=True)
    report = pc2scan.convert(source, None, topics=["/points:=/other"])
    assert report.destination == str(tmp_path / "a_scan.toy")
    assert "/other" in {entry[0] for entry in content(tmp_path / "a_scan.toy")}


@pytest.mark.usefixtures("toy")
def test_the_command_and_batches_know_a_new_container(tmp_path: Path) -> None:
    run = CliRunner().invoke
    words = ["convert", str(FIXTURES / "hall.mcap"), "-o", str(tmp_path / "y.toy"), "--keep-clouds"]
    dry = run(application(), [*words, "--dry-run"])
    assert dry.exit_code == 0, dry.output
    assert "y.toy: toy, about " in dry.output
    done = run(application(), words)
    # No player is known.
    assert done.output.splitlines()[-1] == f"next: pc2scan check {tmp_path / 'y.toy'}"
    report = pc2scan.convert(FIXTURES / "hall.mcap", f"{tmp_path}/", to="toy", keep_clouds=True)
    assert report.destination == str(tmp_path / "hall_scan.toy")
    assert first_part("a_scan.toy") == "a_scan_0.toy"
    assert whole("a_scan_0.toy") == "a_scan.toy"


@pytest.mark.usefixtures("toy")
def test_a_new_container_is_in_what_errors_list(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"hello")
    with pytest.raises(RecordingError) as caught:
        open_recording(tmp_path / "x")
    assert caught.value.hint == "ROS 1 bags, rosbag2 directories, .db3 files, MCAP and toys can be read"
    with pytest.raises(DestinationError, match="`compression=zstd` is not possible here; allowed: none"):
        pc2scan.convert(FIXTURES / "hall.mcap", tmp_path / "y.toy", compression="zstd")
    with pytest.raises(DestinationError) as refused:
        pc2scan.convert(FIXTURES / "hall.mcap", tmp_path / "y.db3")
    assert "NAME.bag, NAME.mcap, NAME.toy, or NAME for a rosbag2 directory" in str(refused.value.hint)


def test_the_table_is_consistent() -> None:
    suffixes = [entry.suffix for entry in FORMATS.values()]
    assert len(suffixes) == len(set(suffixes))
    for name, entry in FORMATS.items():
        assert entry.name == name
        assert bool(entry.magic) != bool(entry.is_in), "a file is known by its beginning, a directory by its files"
        assert entry.default_compression in entry.compressions
        assert set(entry.storages) <= storages().keys()
        assert entry.open_writer is not None or FORMATS[entry.written_as].open_writer is not None


def test_the_command_line_offers_what_the_table_has() -> None:
    known = {name for entry in FORMATS.values() for name in entry.compressions}
    words = {name: option.value.words for name, option in options_of("convert").items()}
    assert set(words["compression"]) == known
    assert set(words["storage"]) == set(storages())
    assert words["to"] == tuple(destinations())


@pytest.mark.parametrize(
    ("names", "text"),
    [((), ""), (("a",), "a"), (("a", "b"), "a and b"), (("a", "b", "c"), "a, b and c")],
)
def test_names_in_a_sentence(names: tuple[str, ...], text: str) -> None:
    assert and_list(names) == text
