"""The table of formats, and a new container as an entry in it."""

from __future__ import annotations

import pickle
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.bags.formats import FORMATS, Format
from pc2scan.bags.opening import open_recording
from pc2scan.model import Writer
from support import ROOT
from support.memory_reader import MemoryReader

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.model import Buffer, Connection
    from pc2scan.threads import Threads

FIXTURES = ROOT / "fixtures"
MAGIC = b"#TOY\n"


def toy_reader(path: Path, *, strict: bool) -> MemoryReader:
    assert not strict
    return MemoryReader(path, *pickle.loads(path.read_bytes()[len(MAGIC) :]), container="toy")


class ToyWriter(Writer):
    """Writes connections and messages as Python's pickles, and nothing else."""

    def __init__(self, path: Path, compression: str) -> None:
        assert compression == "none"
        self._file = path.open("xb")
        self._connections: list[Connection] = []
        self._rows: list[tuple[int, int, bytes]] = []

    def add_connection(self, connection: Connection) -> int:
        self._connections.append(replace(connection, id=len(self._connections)))
        return self._connections[-1].id

    def write(self, handle: int, log_time_ns: int, data: Buffer, publish_time_ns: int, sequence: int = 0) -> None:
        assert publish_time_ns + sequence >= 0
        self._rows.append((handle, log_time_ns, bytes(data)))

    def compress_ahead(self, pool: Threads) -> None:
        pass

    def finish(self) -> None:
        self._file.write(MAGIC + pickle.dumps((self._connections, self._rows)))
        self._file.close()

    def abort(self) -> None:
        self._file.close()


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new container needs only an entry in the table."""
    entry = Format(
        name="toy",
        readable="toy",
        open_reader=toy_reader,
        open_writer=ToyWriter,
        magic=MAGIC,
        suffix=".toy",
        to="toy",
    )
    monkeypatch.setitem(FORMATS, "toy", entry)


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
