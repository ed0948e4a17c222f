"""Whether a format could tell that a recording is damaged: what contradicts itself anywhere in it.

This is the campaign's oracle. It knows the formats by their specifications and asks only libraries other than
pc2scan. A recording in which it finds nothing may have been written so: what was changed there cannot be noticed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import zstandard
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from fuzz.contradictions import database, mcap, rosbag1

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from fuzz.contradictions.mcap import Facts

__all__ = ["contradictions"]


def contradictions(files: Mapping[str, bytes]) -> list[str]:
    """List them, given a recording's files by name; empty if it could be sound."""
    found = []
    facts: dict[str, Facts] = {}
    for name, data in files.items():
        base = name.rsplit("/", 1)[-1]
        if base.endswith(".bag"):
            found += rosbag1.contradictions(data)
        elif base.endswith((".mcap", ".mcap.zstd", ".db3", ".db3.zstd")):
            try:
                facts[base] = _storage(name, data, files)
            except zstandard.ZstdError as err:
                return [f"{base}: {err}"]
            found += [f"{base}: {text}" for text in facts[base].contradictions]
    text = next((data for name, data in files.items() if name.endswith("metadata.yaml")), None)
    if text is not None:
        try:
            found += _metadata(YAML(typ="safe", pure=True).load(text.decode()), facts)
        except (YAMLError, UnicodeDecodeError, KeyError, TypeError, AttributeError, ValueError) as err:
            found.append(f"metadata.yaml: {type(err).__name__}: {err!s:.80}")
    return found


def _storage(name: str, data: bytes, files: Mapping[str, bytes]) -> Facts:
    packed = name.endswith(".zstd")
    if packed:
        data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
    if ".mcap" in name:
        return mcap.facts_of(data)
    return database.facts_of(data, files.get(f"{name}-wal", b""), files.get(f"{name}-journal", b""))


def _metadata(document: Any, facts: Mapping[str, Facts]) -> Iterator[str]:
    """What metadata.yaml says otherwise than the files."""
    root = document["rosbag2_bagfile_information"]
    storages = {"sqlite3" if ".db3" in name else "mcap" for name in facts}
    if {root["storage_identifier"]} != storages:
        yield "the storage"
    if [path.rsplit("/", 1)[-1] for path in root["relative_file_paths"]] != list(facts):
        yield "the file names"
    packed = any(name.endswith(".zstd") for name in facts)
    if packed != (root["compression_mode"].upper() == "FILE"):
        yield "the mode of compression"
    counts = sum(own.counts.total() for own in facts.values())
    times = [time for own in facts.values() for time in own.times] or [0]
    if root["message_count"] != counts:
        yield "the number of messages"
    # Of split recordings, rosbag2 itself wrote wrong times until Humble.
    if len(facts) == 1 and not _covers(root["starting_time"], root["duration"], times):
        yield "the times"
    topics = {}
    for entry in root["topics_with_message_count"]:
        topic = entry["topic_metadata"]
        topics[topic["name"]] = (topic["type"], topic["serialization_format"], entry["message_count"])
    if len(topics) != len(root["topics_with_message_count"]):
        yield "a topic is given twice"
    stored = {}
    for own in facts.values():
        for name, kinds in own.topics.items():
            total = sum(other.counts[name] for other in facts.values())
            stored[name] = (*min(kinds), total)
            if len(kinds) > 1:
                yield f"{name} has two types"
    if topics != stored:
        yield "the topics"


def _covers(start: Any, duration: Any, times: list[int]) -> bool:
    """Whether messages are within declared times; snapshots declare those of the recorder, which are longer."""
    first = start["nanoseconds_since_epoch"]
    return bool(first <= min(times) and max(times) <= first + duration["nanoseconds"])
