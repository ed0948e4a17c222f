"""One mutant of a seed: which file is changed, and how."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import zstandard

from fuzz.mutants import database, layout, mcap, metadata, rosbag1
from fuzz.mutants.layout import Edit, Field, Layout, Nested

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from fuzz.mutants.seeds import Seed

__all__ = ["Mutant", "Stretch", "byte_mutants", "field_mutant", "fields_of", "mutant", "rearranged", "stretches"]

#: Statements that a program other than a recorder may have run: the database is sound afterwards.
_STATEMENTS = (
    "DELETE FROM messages WHERE id = {id}",
    "DELETE FROM messages WHERE id > {id}",
    "DELETE FROM topics WHERE id = 2",
    "UPDATE messages SET timestamp = timestamp + 1 WHERE id = {id}",
    "UPDATE messages SET timestamp = -1 WHERE id = {id}",
    "UPDATE messages SET topic_id = 1 + topic_id % 3 WHERE id = {id}",
    "UPDATE messages SET topic_id = 99 WHERE id = {id}",
    "UPDATE messages SET data = x'' WHERE id = {id}",
    "UPDATE messages SET data = 'text' WHERE id = {id}",
    "UPDATE messages SET timestamp = 'noon' WHERE id = {id}",
    "INSERT INTO messages SELECT id + 1000, topic_id, timestamp, data FROM messages WHERE id = {id}",
    "UPDATE topics SET name = '/other' WHERE id = 2",
    "UPDATE topics SET type = 'std_msgs/msg/Empty' WHERE id = 2",
    "UPDATE topics SET serialization_format = '' WHERE id = 2",
    "INSERT INTO topics SELECT id + 100, name, type, serialization_format, offered_qos_profiles, '' FROM topics",
    "DROP INDEX timestamp_idx",
    "DROP TABLE message_definitions",
)


@dataclass(frozen=True, slots=True)
class Mutant:
    """A seed with one file changed; ``files`` are all of them."""

    seed: Seed
    name: str
    edit: Edit
    files: dict[str, bytes]

    def __str__(self) -> str:
        return f"{self.seed.name}: {self.name}: {self.edit.kind} ({self.edit.how})"


def mutant(seed: Seed, rng: random.Random) -> Mutant:
    """Change one thing in one file of a seed."""
    name = rng.choice(sorted(seed.files))
    while True:
        edit = _edit(name, seed, rng)
        if edit.data != seed.files[name]:
            return Mutant(seed, name, edit, {**seed.files, name: edit.data})


def rearranged(seed: Seed, rng: random.Random) -> Mutant:
    """Remove, repeat, move or exchange whole records in one file of a seed."""
    name = rng.choice(sorted(name for name in seed.files if name.endswith((".bag", ".mcap"))))
    while True:
        edit = layout.rearrange(_layout(name, seed.files[name]), rng)
        if edit.data != seed.files[name]:
            return Mutant(seed, name, edit, {**seed.files, name: edit.data})


def byte_mutants(seed: Seed, places: Iterable[int]) -> Iterator[Mutant]:
    """A seed of one file, cut off at each of these places, and with the byte there changed: one bit or all of them."""
    ((name, data),) = seed.files.items()
    fields = _layout(name, data).fields
    for place in places:
        flipped = bytearray(data)
        flipped[place] ^= 0xFF if place % 2 else 0x01
        kind = next((field.kind for field in fields if field.start <= place < field.stop), "file")
        edits = (
            Edit("file", "file", "cut off", data[:place], (place, len(data))),
            Edit(kind, "file", "flipped", bytes(flipped), (place, place + 1)),
        )
        for edit in edits:
            yield Mutant(seed, name, edit, {name: edit.data})


def field_mutant(seed: Seed, kind: str, rng: random.Random) -> Mutant:
    """A seed of one file with one field of a kind changed; the checksums of its index are right."""
    ((name, data),) = seed.files.items()
    while True:
        edit = layout.change(_layout(name, data), kind, rng, sealed=True)
        if edit.data != data:
            return Mutant(seed, name, edit, {name: edit.data})


def fields_of(path: Path, kind: str) -> list[Field]:
    """The fields of a kind in a file, in their order."""
    found = [field for field in _layout(path.name, path.read_bytes()).fields if field.kind == kind]
    return sorted(found, key=lambda field: field.start)


class Stretch(NamedTuple):
    """A place in a file, and the data of the messages that are stored there."""

    start: int
    stop: int
    messages: frozenset[bytes]


@lru_cache(maxsize=64)
def stretches(name: str, data: bytes, *, within_chunks: bool = False) -> list[Stretch]:
    """Where the chunks of a sound file are, and the messages outside; of chunks that are not packed, those within."""
    return list(_stretches(_layout(name, data), within_chunks))


def _stretches(of: Layout, within_chunks: bool) -> Iterator[Stretch]:
    for record in of.records:
        if record.kind == "message":
            inner = [f for f in of.fields if f.kind == "message.data" and record.start <= f.start < record.stop]
            yield Stretch(record.start, record.stop, frozenset(of.data[f.start : f.stop] for f in inner))
        elif record.kind == "chunk":
            chunk = next(n for n in of.nested if record.start <= n.start < record.stop)
            stored = of.data[chunk.start : chunk.stop]
            unpacked = chunk.unpack(stored)
            inside = list(_stretches(chunk.layout(unpacked), within_chunks))
            if within_chunks and unpacked == stored:
                yield from (Stretch(chunk.start + i.start, chunk.start + i.stop, i.messages) for i in inside)
            else:
                yield Stretch(record.start, record.stop, frozenset().union(*(i.messages for i in inside)))


def _edit(name: str, seed: Seed, rng: random.Random) -> Edit:
    data = seed.files[name]
    if name.endswith("metadata.yaml"):
        return metadata.mutate_metadata(data, rng)
    # With a log or a journal beside it a database is not complete by itself.
    if (
        name.endswith((".db3", ".db3.zstd"))
        and not any(f"{name}-" in other for other in seed.files)
        and rng.random() < 0.2
    ):
        return _statement(data, rng)
    return layout.mutate(_layout(name, data), rng)


@lru_cache(maxsize=64)
def _layout(name: str, data: bytes) -> Layout:
    if name.endswith(".zstd"):
        inner = name.removesuffix(".zstd")
        # Half of the time the packed bytes themselves are changed.
        nested = Nested("zstd", 0, len(data), _unpacked, _packed, lambda unpacked: _layout(inner, unpacked))
        return Layout(data, nested=[nested])
    of: dict[str, Callable[[bytes], Layout]] = {
        "bag": rosbag1.layout,
        "mcap": mcap.layout,
        "db3": database.database_layout,
        "db3-wal": database.wal_layout,
        "db3-journal": database.journal_layout,
    }
    return of[name.rsplit(".", 1)[1]](data)


def _statement(data: bytes, rng: random.Random) -> Edit:
    packed = data.startswith(b"\x28\xb5\x2f\xfd")
    statement = rng.choice(_STATEMENTS)
    with closing(sqlite3.connect(":memory:")) as made:
        made.deserialize(_unpacked(data) if packed else data)
        (count,) = made.execute("SELECT count(*) FROM messages").fetchone()
        made.execute(statement.format(id=rng.randint(1, count)))
        made.commit()
        changed = made.serialize()
    kind = " ".join(statement.split()[: 2 if statement.startswith("D") else 4]).replace("FROM ", "")
    return replace(Edit(f"sql.{kind}", "row", "statement", b""), data=_packed(changed) if packed else changed)


def _unpacked(data: bytes) -> bytes:
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 26)


def _packed(data: bytes) -> bytes:
    return zstandard.ZstdCompressor().compress(data)
