"""A file as fields and records, and what goes wrong with each: the part of the mutator that knows no format.

Formats describe a file as a `Layout`. An edit overwrites a field, or splices records, and may repair what depends on
it: lengths and places ("moved"), and checksums ("sealed"). What a disk does to a file repairs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import random
    from collections.abc import Callable

__all__ = ["Edit", "Field", "Layout", "Nested", "Record", "change", "mutate", "rearrange", "unknown"]

#: What a field is about. Names, texts and payloads are bytes, all others are numbers.
Role = Literal[
    "opcode", "length", "size", "count", "time", "place", "id", "number", "checksum", "name", "text", "payload"
]
BYTES = frozenset({"name", "text", "payload"})

_LARGE = (0x7F, 0xFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)
_NAMES = (b"", b"/", b"/points", b"\xff\xfe", b"a\0b", b"\x1b[2J", b"n" * 300)


@dataclass(frozen=True, slots=True)
class Field:
    """One value in a file.

    Attributes
    ----------
    kind
        Its record and its name: ``chunk.start_time``.
    start, stop
        Its place.
    order
        Of a number's bytes.
    covers
        The bytes that a length or a checksum is about.
    """

    kind: str
    role: Role
    start: int
    stop: int
    order: Literal["little", "big"] = "little"
    covers: tuple[int, int] | None = None

    def value(self, data: bytes | bytearray) -> int:
        """The number."""
        return int.from_bytes(data[self.start : self.stop], self.order)


@dataclass(frozen=True, slots=True)
class Record:
    """A stretch of a file that can be removed, repeated or moved."""

    kind: str
    start: int
    stop: int


@dataclass(frozen=True, slots=True)
class Nested:
    """Bytes that have a layout of their own, compressed or not.

    Attributes
    ----------
    kind
        Put in front of the kinds within.
    start, stop
        The place of the stored bytes.
    size, checksum
        The fields outside that are about the unpacked bytes.
    """

    kind: str
    start: int
    stop: int
    unpack: Callable[[bytes], bytes]
    pack: Callable[[bytes], bytes]
    layout: Callable[[bytes], Layout]
    size: Field | None = None
    checksum: Field | None = None


@dataclass(slots=True)
class Layout:
    """A file, or a part of one.

    Attributes
    ----------
    seal
        Repairs the checksums of changed bytes in place, given where a place went.
    crc
        Of unpacked bytes, as the checksum of a `Nested` has it.
    """

    data: bytes
    fields: list[Field] = field(default_factory=list)
    records: list[Record] = field(default_factory=list)
    nested: list[Nested] = field(default_factory=list)
    seal: Callable[[bytearray, Callable[[int], int]], None] | None = None
    crc: Callable[[bytes], int] | None = None


@dataclass(frozen=True, slots=True)
class Edit:
    """A change: what was changed, in which way, and the bytes afterwards.

    Attributes
    ----------
    place
        Where bytes are others, or are missing at the end, if all others are where they were.
    """

    kind: str
    role: str
    how: str
    data: bytes
    place: tuple[int, int] | None = None


def unknown(data: bytes, rng: random.Random) -> Layout:
    """Bytes of a format that is not known: there may be a number of any width at any place."""
    kinds: list[tuple[int, Literal["little", "big"]]] = [(1, "little"), (2, "little"), (4, "little"), (8, "little")]
    kinds.append((4, "big"))
    return Layout(
        data,
        [
            Field(f"any.{size}{order}", "number", start, start + size, order)
            for size, order in kinds
            for start in rng.choices(range(len(data) - size + 1), k=4 if len(data) >= size else 0)
        ],
    )


def mutate(layout: Layout, rng: random.Random) -> Edit:
    """Change one thing: a field, each kind as often as any other, or a whole record, or anything anywhere."""
    sealed = layout.seal is not None and rng.random() < 0.4
    if layout.nested and (not layout.fields or rng.random() < 0.4):
        return _inside(layout, rng.choice(layout.nested), rng, mutate)
    choice = rng.random()
    if layout.records and choice < 0.15:
        return _records(layout, rng, sealed=sealed)
    if choice < 0.22 or not layout.fields:
        return _anywhere(layout, rng)
    kind = rng.choice(sorted({f.kind for f in layout.fields}))
    return change(layout, kind, rng, sealed=sealed)


def change(layout: Layout, kind: str, rng: random.Random, *, sealed: bool) -> Edit:
    """Change a field of a kind."""
    chosen = rng.choice([f for f in layout.fields if f.kind == kind])
    changed_value = _changed_bytes if chosen.role in BYTES else _changed_number
    how, new = changed_value(layout, chosen, rng)
    if len(new) == chosen.stop - chosen.start:
        changed = bytearray(layout.data)
        changed[chosen.start : chosen.stop] = new
        if sealed and layout.seal is not None:
            layout.seal(changed, lambda place: place)
        data = bytes(changed)
    else:
        data = _spliced(layout, chosen.start, chosen.stop, new, sealed=sealed)
    return Edit(chosen.kind, chosen.role, how + (", sealed" if sealed else ""), data)


def rearrange(layout: Layout, rng: random.Random) -> Edit:
    """Change one whole record, or two of them, here or in what is packed."""
    if layout.nested and (not layout.records or rng.random() < 0.15):
        return _inside(layout, rng.choice(layout.nested), rng, rearrange)
    return _records(layout, rng, sealed=layout.seal is not None and rng.random() < 0.4)


def _changed_number(layout: Layout, chosen: Field, rng: random.Random) -> tuple[str, bytes]:
    size = chosen.stop - chosen.start
    old = chosen.value(layout.data)
    alike = [f.value(layout.data) for f in layout.fields if f.kind == chosen.kind]
    related = [f.value(layout.data) for f in layout.fields if f.role == chosen.role]
    near = {"time": (1, 1_000, 10**9, 86_400 * 10**9), "place": (1, 8, 512, 4096)}.get(chosen.role, (1, 1, 2, 8))
    how = rng.choice(("bit", "bit", "near", "near", "zero", "large", "alike", "related", "any"))
    new = {
        "bit": old ^ 1 << rng.randrange(8 * size),
        "near": old + rng.choice((-1, 1)) * rng.choice(near),
        "zero": 0,
        "large": rng.choice(_LARGE),
        "alike": rng.choice(alike),
        "related": rng.choice(related),
        "any": rng.randrange(1 << rng.choice((8, 16, 8 * size))),
    }[how] % (1 << 8 * size)
    if new == old:
        how, new = "bit", old ^ 1
    return how, new.to_bytes(size, chosen.order)


def _changed_bytes(layout: Layout, chosen: Field, rng: random.Random) -> tuple[str, bytes]:
    old = layout.data[chosen.start : chosen.stop]
    alike = [layout.data[f.start : f.stop] for f in layout.fields if f.kind == chosen.kind]
    how = rng.choice(("bit", "bit", "block", "shorter", "longer", "alike", "other"))
    changed = bytearray(old)
    if how == "bit" and old:
        changed[rng.randrange(len(old))] ^= 1 << rng.randrange(8)
    elif how == "block" and old:
        place = rng.randrange(len(old))
        length = min(rng.choice((4, 64, 512, 4096)), len(old) - place)
        changed[place : place + length] = rng.choice((bytes(length), b"\xff" * length, rng.randbytes(length)))
    elif how == "shorter":
        del changed[rng.randrange(len(old) + 1) :]
    elif how == "alike":
        changed = bytearray(rng.choice(alike))
    elif how == "other" and chosen.role == "name":
        changed = bytearray(rng.choice(_NAMES))
    else:
        how = "longer"
        changed += rng.randbytes(rng.choice((1, 7, 100, 3000)))
    return how, bytes(changed)


def _records(layout: Layout, rng: random.Random, *, sealed: bool) -> Edit:
    """Remove, repeat, move, exchange or overwrite whole records."""
    kind = rng.choice(sorted({record.kind for record in layout.records}))
    chosen = rng.choice([record for record in layout.records if record.kind == kind])
    start, stop = chosen.start, chosen.stop
    own = layout.data[start:stop]
    alike = rng.choice([record for record in layout.records if record.kind == kind])
    other = rng.choice((alike, rng.choice(layout.records)))
    how = rng.choice(("removed", "removed", "repeated", "replaced", "moved", "copied", "exchanged", "blanked"))
    if how == "exchanged":
        return Edit(kind, "record", f"{how} with {other.kind}", _exchanged(layout.data, chosen, other))
    new = {
        "removed": b"",
        "repeated": own + own,
        "replaced": layout.data[alike.start : alike.stop],
        "moved": b"",
        "copied": own,
        "blanked": bytes(len(own)),
    }[how]
    repaired = rng.random() < 0.5
    if repaired:
        data = _spliced(layout, start, stop, new, sealed=sealed)
    else:
        data = layout.data[:start] + new + layout.data[stop:]
    if how in ("moved", "copied"):
        place = other.start - len(own) * (how == "moved" and other.start > start)
        data = data[:place] + own + data[place:]
        how = f"{how} to {other.kind}"
    return Edit(kind, "record", f"{how}{', places repaired' * repaired}{', sealed' * (sealed and repaired)}", data)


def _exchanged(data: bytes, one: Record, other: Record) -> bytes:
    first, second = sorted((one, other), key=lambda record: record.start)
    middle = data[first.stop : second.start]
    if first == second:
        return data
    return (
        data[: first.start]
        + data[second.start : second.stop]
        + middle
        + data[first.start : first.stop]
        + data[second.stop :]
    )


def _anywhere(layout: Layout, rng: random.Random) -> Edit:
    """Damage as disks, networks and people do, without a look at what is there."""
    data = layout.data
    edges = sorted({0, len(data), *(e for r in layout.records for e in (r.start, r.stop))})
    place = min(max(0, rng.choice(edges) + rng.choice((0, 0, 1, -1, 9))), len(data))
    if rng.random() < 0.3:
        place = rng.randrange(len(data) + 1)
    block = place // 512 * 512
    how = rng.choice(("cut", "cut", "inserted", "lost", "zeros", "appended", "twice", "flip"))
    changed = {
        "cut": data[:place],
        "inserted": data[:place] + rng.randbytes(rng.choice((1, 8, 100, 5000))) + data[place:],
        "lost": data[:place] + data[place + rng.choice((1, 4, 100, 4096)) :],
        "zeros": data[:block] + bytes(len(data[block : block + 512])) + data[block + 512 :],
        "appended": data + rng.choice((b"\0" * 4096, rng.randbytes(100), b"\n")),
        "twice": data + data,
        "flip": b"",
    }[how]
    if how == "flip":
        place = min(place, len(data) - 1)
        changed = data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :] if data else b"x"
    return Edit("file", "file", how, changed)


def _inside(
    layout: Layout, chosen: Nested, rng: random.Random, change: Callable[[Layout, random.Random], Edit]
) -> Edit:
    """Change what is packed, and pack it again; the lengths and checksums around it are updated."""
    unpacked = chosen.unpack(layout.data[chosen.start : chosen.stop])
    edit = change(chosen.layout(unpacked), rng)
    data = _spliced(layout, chosen.start, chosen.stop, chosen.pack(edit.data), sealed=False)
    changed = bytearray(data)
    if chosen.size is not None and rng.random() < 0.9:
        _put(changed, chosen.size, len(edit.data))
    sealed = chosen.checksum is not None and layout.crc is not None and rng.random() < 0.7
    if sealed and chosen.checksum is not None and layout.crc is not None:
        _put(changed, chosen.checksum, layout.crc(edit.data))
        if layout.seal is not None:
            layout.seal(changed, _mover(chosen.start, chosen.stop, len(data) - len(layout.data)))
    how = edit.how + (", sealed" if sealed else "")
    return replace(edit, kind=f"{chosen.kind}/{edit.kind}", how=how, data=bytes(changed))


def _spliced(layout: Layout, start: int, stop: int, new: bytes, *, sealed: bool) -> bytes:
    """Replace bytes, and repair the lengths around them and the places behind them."""
    delta = len(new) - (stop - start)
    changed = bytearray(layout.data[:start] + new + layout.data[stop:])
    moved = _mover(start, stop, delta)
    for entry in layout.fields:
        if start <= entry.start < stop:
            continue
        value = entry.value(layout.data)
        if entry.role == "length" and entry.covers and entry.covers[0] <= start and stop <= entry.covers[1]:
            value += delta
        elif entry.role == "place":
            value = moved(value)
        else:
            continue
        _put(
            changed, replace(entry, start=moved(entry.start), stop=moved(entry.start) + entry.stop - entry.start), value
        )
    if sealed and layout.seal is not None:
        layout.seal(changed, moved)
    return bytes(changed)


def _mover(start: int, stop: int, delta: int) -> Callable[[int], int]:
    return lambda place: place + delta if place >= stop and place > start else place


def _put(data: bytearray, entry: Field, value: int) -> None:
    size = entry.stop - entry.start
    data[entry.start : entry.stop] = (value % (1 << 8 * size)).to_bytes(size, entry.order)
