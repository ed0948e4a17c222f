"""Reading rosbag2 directories: metadata.yaml of every version, several files, compression, and contradictions."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from ruamel.yaml import YAML

from pc2scan.bags.folders import storage_files
from pc2scan.bags.rosbag2.read import Rosbag2Reader
from pc2scan.errors import DamageError, RecordingError
from support.rosbag2_files import DEFINITION, QOS_NAMES, QOS_NUMBERS, listed, read, write_metadata, write_storage
from support.tables import rows

if TYPE_CHECKING:
    from pc2scan.bags.damage import Damage

TABLES = Path(__file__).with_name("metadata.txt")
STORAGES = {"db3": "sqlite3", "mcap": "mcap"}


def times_of(bag: Path, **options: Any) -> tuple[list[int], tuple[Damage, ...]]:
    with closing(Rosbag2Reader(bag, **options)) as reader:
        return [m.log_time_ns for m in reader.messages()], reader.damage


@pytest.mark.parametrize("version", range(1, 10))
def test_every_version_of_metadata_is_read(version: int, bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3), ("/b", 4)], qos="", digest="", latching=False)
    write_metadata(bag, version, ["bag_0.db3"])
    with closing(Rosbag2Reader(bag)) as reader:
        a, b, silent = reader.connections
        assert [c.topic for c in (a, b, silent)] == ["/a", "/b", "/silent"]
        assert len({c.id for c in (a, b, silent)}) == 3
        expected = "" if version < 4 else QOS_NUMBERS if version < 9 else QOS_NAMES
        assert YAML(typ="safe").load(a.qos) == YAML(typ="safe").load(expected)
        assert version == 9 or a.qos == expected
        assert (a.latching, a.digest) == (version >= 4, "RIHS01_listed" if version >= 7 else "")
        assert (a.definition, b.qos, b.digest) == (DEFINITION, "", "")
        assert (silent.message_count, a.message_count) == (0, 1)
        assert [(m.connection, m.log_time_ns) for m in reader.messages()] == [(a, 3), (b, 4)]
        assert [m.log_time_ns for m in reader.messages([b, silent])] == [4]
        assert list(reader.messages([silent])) == []
        summary = reader.summary
        assert (summary.container, summary.storage, summary.compression) == ("rosbag2", "sqlite3", ("none",))
        assert (summary.message_count, summary.start_ns, summary.end_ns) == (2, 3, 4)
        assert reader.path == bag


@pytest.mark.parametrize("suffix", STORAGES)
@pytest.mark.parametrize("with_metadata", [True, False])
def test_split_recordings_are_merged_by_time(suffix: str, with_metadata: bool, bag: Path) -> None:
    write_storage(bag / f"bag_2.{suffix}", [("/a", 1), ("/b", 2), ("/a", 9)])
    write_storage(bag / f"bag_10.{suffix}", [("/b", 2), ("/a", 3)])
    if with_metadata:
        files = [f"bag_2.{suffix}", f"bag_10.{suffix}"]
        write_metadata(bag, 5, files, STORAGES[suffix], topics_with_message_count=[])
    with closing(Rosbag2Reader(bag)) as reader:
        assert [(c.id, c.topic, c.message_count) for c in reader.connections] == [(1, "/a", 3), (2, "/b", 2)]
        found = [(m.connection.topic, m.log_time_ns) for m in reader.messages()]
        assert found == [("/a", 1), ("/b", 2), ("/b", 2), ("/a", 3), ("/a", 9)]
        assert reader.summary.size_bytes == sum(f.stat().st_size for f in storage_files(bag))


@pytest.mark.parametrize("name", ["../outside.db3", "/etc/outside.db3", "C:\\x\\outside.db3", "sub/outside.db3"])
def test_only_files_in_the_directory_are_opened(name: str, bag: Path) -> None:
    write_storage(bag.parent / "outside.db3", [("/secret", 3)])
    write_metadata(bag, 5, [name])
    with pytest.raises(RecordingError, match=r"names outside\.db3, which is not in the directory"):
        Rosbag2Reader(bag)
    write_storage(bag / "outside.db3", [("/a", 4)])
    assert [m[0] for m in read(bag)] == ["/a"]


# --- What cannot be read ---


@pytest.mark.parametrize(("changes", "told"), rows(TABLES, "changes, or bytes, and what is told"), ids=str)
def test_metadata_that_cannot_be_understood_is_refused(changes: dict[str, Any] | bytes, told: str, bag: Path) -> None:
    write_storage(bag / "bag_0.db3", [("/a", 3)])
    if isinstance(changes, bytes):
        (bag / "metadata.yaml").write_bytes(changes)
    else:
        write_metadata(bag, 8, ["bag_0.db3"], **changes)
    with pytest.raises(RecordingError, match=told) as caught:
        Rosbag2Reader(bag, strict=True)
    assert caught.value.path == bag / "metadata.yaml"
    assert caught.value.hint


# --- What contradicts itself, or is not there ---


def declared(changes: dict[str, Any]) -> dict[str, Any]:
    """Changes of metadata.yaml: ``span`` is the first time and the duration, ``listed`` how many messages /a has."""
    more = {name: value for name, value in changes.items() if name not in ("span", "listed")}
    if "span" in changes:
        start, duration = changes["span"]
        more |= {"starting_time": {"nanoseconds_since_epoch": start}, "duration": {"nanoseconds": duration}}
    if "listed" in changes:
        more["topics_with_message_count"] = [listed("/a", 8, changes["listed"])]
    if "files" in changes:
        more["files"] = [declared(file) for file in changes["files"]]
    return more


@pytest.mark.parametrize(("_name", "parts", "metadata", "expected"), rows(TABLES, "contradictions", text=True))
def test_a_contradiction_is_damage_and_the_rest_is_read(
    _name: str, parts: dict[str, Any], metadata: Any, expected: tuple[str, str, int | None] | None, bag: Path
) -> None:
    for file, content in parts.items():
        if isinstance(content, bytes):
            (bag / file).write_bytes(content)
        elif content is not None:
            write_storage(bag / file, [("/a", time_ns) for time_ns in content])
    if isinstance(metadata, bytes):
        (bag / "metadata.yaml").write_bytes(metadata)
    elif metadata is not None:
        write_metadata(bag, 8, list(parts), **declared(metadata))
    found, damage = times_of(bag)
    assert found == [time_ns for content in parts.values() if isinstance(content, list) for time_ns in content]
    if expected is None:
        assert damage == ()
        assert times_of(bag, strict=True)[0] == found
        return
    file, told, lost = expected
    (place,) = damage
    assert told in place.what
    assert (place.path, place.messages_lost, place.bytes_lost) == (bag / file if file else bag, lost, 0)
    with pytest.raises(DamageError) as caught:
        Rosbag2Reader(bag, strict=True)
    assert told in caught.value.message
