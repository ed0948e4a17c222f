"""Computes ROS's hashes of a type: ROS 1's md5sum, ROS 2's RIHS01."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from .message_sets import fielddefs
from .rendering import constant_lines, type_word
from .types import PRIMITIVES, builtin, fields_of

if TYPE_CHECKING:
    from .types import Schema


def md5sum(schema: Schema) -> str:
    """Compute ROS 1's hash of a schema's first type: the MD5 of its text, nested types as their sums."""
    sums: dict[str, str] = {}

    def identify(name: str) -> str:
        if name not in sums:
            lines = [*constant_lines(schema[name], 1)]
            for field in fields_of(name, schema[name], 1):
                plain = field.type in PRIMITIVES or builtin(field.type)
                lines.append(f"{type_word(field, 1) if plain else identify(field.type)} {field.name}")
            sums[name] = hashlib.md5("\n".join(lines).encode(), usedforsecurity=False).hexdigest()
        return sums[name]

    return identify(next(iter(schema)))


def rihs01(schema: Schema) -> str:
    """Compute ROS 2's hash of a schema's first type."""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    store = get_typestore(Stores.EMPTY)
    # Only the parse trees are needed: nothing is registered, so no code is generated from the names.
    store.fielddefs = fielddefs(schema, str, lambda _, field: field.name)
    return store.hash_rihs01(next(iter(schema)))
