"""What goes wrong with rosbag2's metadata.yaml: values, lines, and the file as a whole."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from fuzz.mutants.layout import Edit

if TYPE_CHECKING:
    import random

__all__ = ["mutate_metadata"]

_LINE = re.compile(r"^(\s*(?:- )?)([a-z_0-9]+): ?(.*)$")
_NUMBERS = ("0", "-1", "1", str(1 << 63), "1e9", "9" * 30, "~", "many", "[1, 2]", "")
_TEXTS = (
    "",
    "/",
    "../x.db3",
    "cdr",
    "sqlite3",
    "mcap",
    "zstd",
    "FILE",
    "MESSAGE",
    "a: b",
    "x" * 400,
    "\u202e",
    "7",
    "~",
)


def mutate_metadata(data: bytes, rng: random.Random) -> Edit:
    """Change one value, one line, or the bytes."""
    lines = data.decode().splitlines()
    choice = rng.random()
    if choice < 0.7:
        return _value(lines, rng)
    if choice < 0.9:
        place = rng.randrange(len(lines))
        how = rng.choice(("removed", "repeated", "exchanged", "indented", "cut"))
        other = rng.randrange(len(lines))
        changed = list(lines)
        if how == "removed":
            del changed[place]
        elif how == "repeated":
            changed.insert(place, lines[place])
        elif how == "exchanged":
            changed[place], changed[other] = changed[other], changed[place]
        elif how == "indented":
            changed[place] = "  " + changed[place]
        else:
            del changed[place:]
        return Edit("metadata.line", "record", how, "\n".join([*changed, ""]).encode())
    how = rng.choice(("empty", "bit", "bytes"))
    if how == "empty":
        return Edit("metadata.file", "file", how, b"")
    changed_bytes = bytearray(data)
    place = rng.randrange(len(data))
    changed_bytes[place] = changed_bytes[place] ^ 1 << rng.randrange(8) if how == "bit" else rng.randrange(256)
    return Edit("metadata.file", "file", how, bytes(changed_bytes))


def _value(lines: list[str], rng: random.Random) -> Edit:
    found = [(number, match) for number, line in enumerate(lines) if (match := _LINE.match(line)) and match[3]]
    key = rng.choice(sorted({match[2] for _, match in found}))
    number, match = rng.choice([entry for entry in found if entry[1][2] == key])
    old = match[3]
    if re.fullmatch(r"-?\d+", old):
        how = rng.choice(("near", "near", "other"))
        new = str(int(old) + rng.choice((-1, 1, 10, 10**9))) if how == "near" else rng.choice(_NUMBERS)
        role = "time" if "nanoseconds" in key else "count" if "count" in key else "number"
    else:
        how, role = "other", "text" if key == "offered_qos_profiles" else "name"
        new = rng.choice((*_TEXTS, old[:-1], old + "x", old.upper()))
    changed = [*lines[:number], f"{match[1]}{key}: {new}", *lines[number + 1 :], ""]
    return Edit(f"metadata.{key}", role, how, "\n".join(changed).encode())
