"""Chunks that are skimmed give the same messages as chunks that are loaded, and large ones of others are not read."""

from __future__ import annotations

import random
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

from benchmarks.long import Long
from pc2scan import convert
from pc2scan.bags.changed import ChangedReader
from pc2scan.bags.chunks import SKIMMED_BYTES
from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.bags.merged import MergedReader
from pc2scan.bags.observers import Again, Observer, observe
from pc2scan.bags.opening import open_recording
from pc2scan.errors import DamageError
from pc2scan.files.source import SourceFile
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.model import Connection, RawMessage, copied_message

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Reader

FORMATS = {"mcap": 2, "bag": 1}

#: Sizes of messages of the topics /0, /1 and /2 in turn: small and large ones, and some that end next to the bytes that
#: are read at a time.
SIZES = [
    *(0, 1, 200, 16_000, SKIMMED_BYTES, 300_000, 40, 40, 100_000, 0),
    *range(SKIMMED_BYTES - 400, SKIMMED_BYTES + 40, 7),
    *(500_000, 3, 70_000),
]


def recorded(path: Path, sizes: Sequence[int] = SIZES) -> Path:
    """A recording with messages of these sizes, not compressed."""
    version = FORMATS[path.suffix[1:]]
    writer = open_writer(plan_destination(path, compression="none", source_ros_version=version), path, path.name)
    kind = POINTCLOUD2, "ros1" if version == 1 else "cdr", *definition(POINTCLOUD2, version)
    handles = [writer.add_connection(Connection(0, f"/{number}", *kind)) for number in range(3)]
    for number, size in enumerate(sizes):
        data = random.Random(number).randbytes(size)
        writer.write(handles[number % 3], 10 + number, data, 10 + number, number)
    writer.finish()
    return path


@pytest.fixture(params=FORMATS)
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return recorded(tmp_path / f"made.{request.param}")


def rows(messages: Iterable[RawMessage]) -> list[tuple[str, int, bytes]]:
    return [(each.connection.topic, each.log_time_ns, bytes(each.data)) for each in messages]


def skimmed(reader: Reader, topics: Sequence[str]) -> Iterator[RawMessage]:
    """Yield the messages of these topics: what each unit has of them if it is skimmed."""
    for unit in reader.units():
        assert unit.skim is not None
        load = unit.skim([each.id for each in reader.connections if each.topic in topics])
        yield from load(copied_message, whole=False)  # type: ignore[misc]


@pytest.mark.parametrize("topics", [("/0",), ("/1",), ("/2", "/0"), ("/0", "/1", "/2"), ()])
def test_skimming_gives_the_messages_that_loading_gives(path: Path, topics: tuple[str, ...]) -> None:
    with closing(open_recording(path)) as reader:
        loaded = reader.messages([each for each in reader.connections if each.topic in topics])
        assert rows(skimmed(reader, topics)) == rows(loaded)
        assert not reader.damage


def test_wrapped_recordings_are_skimmed_as_they_are_loaded(path: Path) -> None:
    def change(message: RawMessage) -> RawMessage:
        return message._replace(data=b"changed")

    other = recorded(path.with_name(f"other{path.suffix}"), [9, 9, 9, 80_000])
    first, second = open_recording(path), open_recording(other)
    changed = ChangedReader(first, {each.id: change for each in first.connections if each.topic == "/1"})
    with closing(MergedReader([changed, second])) as reader:
        # Another id than in the file.
        topics = ("/1", "/2")
        loaded = rows(reader.messages([each for each in reader.connections if each.topic in topics]))
        assert sorted(rows(skimmed(reader, topics))) == sorted(loaded)
        assert ("/1", 11, b"changed") in loaded


def bytes_read(path: Path, monkeypatch: pytest.MonkeyPatch, *observed: str, again: Again | None = None) -> int:
    """Observe all messages of some topics, and return how many bytes of the file are read for it."""
    with closing(open_recording(path)) as reader:
        counted: list[int] = []
        for name in ("read", "borrow"):
            original = getattr(SourceFile, name)

            def counting(file: SourceFile, offset: int, length: int, original: object = original) -> object:
                counted.append(length)
                return original(file, offset, length)  # type: ignore[operator]

            monkeypatch.setattr(SourceFile, name, counting)
        connections = [each for each in reader.connections if each.topic in observed]
        observer = Observer(connections, copied_message)
        observe((reader, [observer]), again=again or Again())
        monkeypatch.undo()
        assert rows(observer.found) == rows(reader.messages(connections))
        return sum(counted)


def test_large_messages_that_nobody_wants_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Five clouds, and small messages before each.
    sizes = [40, 50, 400_000] * 5
    bag, mcap = (recorded(tmp_path / name, sizes) for name in ("a.bag", "a.mcap"))
    assert bytes_read(bag, monkeypatch, "/0", "/1") < 300_000
    assert bytes_read(bag, monkeypatch, "/2") > 1_500_000
    # Chunks of MCAP have a checksum, which somebody has to compare.
    every = frozenset(range(1, 4))
    assert bytes_read(mcap, monkeypatch, "/0", "/1") > 1_500_000
    assert bytes_read(mcap, monkeypatch, "/0", "/1", again=Again(every)) < 300_000
    assert bytes_read(mcap, monkeypatch, "/0", "/1", again=Again(every, 100)) > 1_500_000
    assert bytes_read(mcap, monkeypatch, "/0", "/1", again=Again(every, None, 10)) > 1_500_000
    assert bytes_read(mcap, monkeypatch, "/0", "/1", again=Again(frozenset([99]))) > 1_500_000


@pytest.mark.parametrize("seed", range(60))
def test_damage_is_found_and_recovered_as_by_loading(path: Path, seed: int) -> None:
    chance = random.Random(seed)
    data = bytearray(path.read_bytes())
    with closing(open_recording(path)) as reader:
        # Headers of messages, mostly: nothing else is read of large ones.
        places = [data.find(bytes(each.data)) for each in reader.messages() if each.size > 8]
    for _ in range(chance.randint(1, 3)):
        data[chance.choice(places) - chance.randint(1, 60)] = chance.randrange(256)
    path.write_bytes(data)
    found = []
    for again in (Again(), Again(frozenset(range(4)))):
        with closing(open_recording(path)) as reader:
            observer = Observer([each for each in reader.connections if each.topic != "/2"], copied_message)
            observe((reader, [observer]), again=again)
            list(reader.messages())
            found.append((rows(observer.found), {each.offset for each in reader.damage}))
    assert found[0] == found[1]


@pytest.mark.parametrize("cut", [{}, {"start": 0.4}])
def test_a_conversion_reports_damage_that_it_skims(cut: dict[str, Any], tmp_path: Path) -> None:
    path = Long(6, points=16_384).write(tmp_path / "a.mcap")
    data = bytearray(path.read_bytes())
    with closing(open_recording(path)) as reader:
        tf = [each for each in reader.messages() if each.connection.topic == "/tf"]
    # In the rotation: nothing but the checksum shows it.
    data[data.find(bytes(tf[15].data)) + len(tf[15].data) - 4] ^= 1
    path.write_bytes(data)
    options = {"min_height": -2, "target_frame": "odom", **cut}
    report = convert(path, tmp_path / "scans.mcap", **options)
    assert ["CRC" in place.what for place in report.damage] == [True]
    with pytest.raises(DamageError, match="CRC"):
        convert(path, tmp_path / "other.mcap", strict=True, **options)
    assert not (tmp_path / "other.mcap").exists()
