"""Sound recordings that are cut off, of which bytes are others, or whose records are removed, repeated or exchanged."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from fuzz.records import edges

if TYPE_CHECKING:
    import random
    from collections.abc import Iterable, Iterator

    from fuzz.seeds import Seed


@dataclass(frozen=True, slots=True)
class Mutant:
    """A seed of which one file is changed.

    Attributes
    ----------
    place
        Where bytes are others, or are missing at the end, if all others are where they were.
    """

    seed: Seed
    name: str
    how: str
    data: bytes
    place: tuple[int, int] | None = None

    @property
    def files(self) -> dict[str, bytes]:
        """All files."""
        return {**self.seed.files, self.name: self.data}

    def __str__(self) -> str:
        return f"{self.seed.name}: {self.name}: {self.how}"


def at_each(seed: Seed, places: Iterable[int]) -> Iterator[Mutant]:
    """A seed of one file, cut off at each place, and with the byte there changed: one bit or all of them."""
    ((name, data),) = seed.files.items()
    for place in places:
        yield Mutant(seed, name, f"cut off at {place}", data[:place], (place, len(data)))
        flipped = bytes([data[place] ^ (0xFF if place % 2 else 0x01)])
        changed = data[:place] + flipped + data[place + 1 :]
        yield Mutant(seed, name, f"flipped at {place}", changed, (place, place + 1))


def damaged(seed: Seed, rng: random.Random) -> Mutant:
    """Damage one file as disks, networks and programs do; half of the time at the edge of a record."""
    name = rng.choice(sorted(seed.files))
    data = seed.files[name]
    place = rng.randrange(len(data))
    if rng.random() < 0.5:
        place = min(max(0, rng.choice(edges(name, data)) + rng.choice((-1, 0, 0, 1, 9, 17))), len(data) - 1)
    size = rng.choice((1, 2, 4, 8, 512))
    number = rng.choice((0, 1, 0x7F, 0xFF, 0x7FFF_FFFF, 0xFFFF_FFFF, (1 << 63) - 1)).to_bytes(8, "little")
    how = rng.choice(("cut off", "flipped", "flipped", "number", "zeros", "lost", "inserted", "appended"))
    head, tail = data[:place], data[place + size :]
    changed = {
        "cut off": head,
        "flipped": head + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :],
        "number": head + number[: min(size, len(data) - place)] + data[place + min(size, 8) :],
        "zeros": head + bytes(len(data) - place - len(tail)) + tail,
        "lost": head + tail,
        "inserted": head + rng.randbytes(size) + data[place:],
        "appended": data + rng.choice((bytes(4096), rng.randbytes(size), data)),
    }[how]
    known = how == "flipped" and len(seed.files) == 1 and name.endswith((".bag", ".mcap"))
    return Mutant(seed, name, f"{how} at {place} ({size})", changed, (place, place + 1) if known else None)


def rearranged(seed: Seed, rng: random.Random) -> Mutant:
    """Remove, repeat, move or exchange whole records."""
    ((name, data),) = seed.files.items()
    bounds = edges(name, data)
    parts = [data[start:stop] for start, stop in pairwise(bounds)]
    one, other = rng.randrange(len(parts)), rng.randrange(len(parts))
    how = rng.choice(("removed", "repeated", "exchanged", "moved", "blanked"))
    match how:
        case "removed":
            del parts[one]
        case "repeated":
            parts.insert(other, parts[one])
        case "exchanged":
            parts[one], parts[other] = parts[other], parts[one]
        case "moved":
            parts.insert(other, parts.pop(one))
        case "blanked":
            parts[one] = bytes(len(parts[one]))
    changed = data[: bounds[0]] + b"".join(parts) + data[bounds[-1] :]
    return Mutant(seed, name, f"record {one} {how} (and {other})", changed)
