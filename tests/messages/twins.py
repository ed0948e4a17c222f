"""Connections of types made here, and messages of them in every serialisation."""

from __future__ import annotations

import random
import struct
from typing import TYPE_CHECKING, Any

from pc2scan.messages import transcode
from pc2scan.messages.transcode import transcoder
from pc2scan.model import Connection, Definition

if TYPE_CHECKING:
    from collections.abc import Mapping


SEPARATOR = "=" * 80

CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


class Twin:
    """One random message in both serialisations.

    The rules are written out one primitive at a time and share nothing with rosbags.
    """

    def __init__(self, structs: Mapping[str, Any], root: str, seed: int) -> None:
        self.structs = structs
        self.random = random.Random(seed)
        self.ros1 = bytearray()
        #: The same with every Header's sequence number 0.
        self.ros1_unnumbered = bytearray()
        self.little = bytearray()
        self.message(root)

    @property
    def cdr(self) -> bytes:
        return b"\0\1\0\0" + bytes(self.little)

    def primitive(self, code: str, value: float) -> None:
        packed = struct.pack("<" + code, value)
        self.ros1 += packed
        self.ros1_unnumbered += packed
        self.little.extend(bytes(-len(self.little) % len(packed)) + packed)

    def string(self) -> None:
        text = self.random.choice(["", "odom", "größe", "a longer piece of text", "x\0y"]).encode()
        for packed in (self.ros1, self.ros1_unnumbered):
            packed.extend(struct.pack("<I", len(text)) + text)
        self.little.extend(bytes(-len(self.little) % 4) + struct.pack("<I", len(text) + 1) + text + b"\0")

    def value(self, word: str) -> None:
        if word == "string":
            self.string()
        elif word not in CODES:
            self.message(word)
        elif word.startswith("float"):
            # Fractions of 2 survive the way through Python's floats that big-endian messages take.
            self.primitive(CODES[word], self.random.randrange(-(1 << 20), 1 << 20) / 64)
        elif word == "bool":
            self.primitive("?", self.random.randrange(2))
        else:
            bits = 8 * struct.calcsize("<" + CODES[word])
            low = -(1 << (bits - 1)) if CODES[word].islower() else 0
            self.primitive(CODES[word], low + self.random.getrandbits(bits))

    def message(self, name: str) -> None:
        if name in transcode.BUILTIN:
            self.primitive("i", self.random.getrandbits(31))
            self.primitive("I", self.random.randrange(1_000_000_000))
            return
        if name == transcode.HEADER:
            self.ros1 += struct.pack("<I", self.random.getrandbits(32))
            self.ros1_unnumbered += bytes(4)
        fields = self.structs[name][1]
        if not fields:
            self.little += b"\0"
        for field in fields:
            count = field.size
            if count < 0:
                count = self.random.choice([0, 1, 2, 5])
                self.primitive("I", count)
            for _ in range(count):
                self.value(field.type)


def ros1(text: str, msgtype: str = "pkg/Type", **more: Any) -> Connection:
    return Connection(1, "/topic", msgtype, "ros1", Definition("ros1msg", text.encode()), **more)


def ros2(text: str, msgtype: str = "pkg/msg/Type", encoding: str = "ros2msg", **more: Any) -> Connection:
    return Connection(1, "/topic", msgtype, "cdr", Definition(encoding, text.encode()), **more)


def of_kind(kind: str, text: str) -> Connection:
    """A connection of a definition of ``ros1``, ``ros2`` or ``ros2idl``."""
    return ros1(text) if kind == "ros1" else ros2(text, encoding="ros2idl" if kind == "ros2idl" else "ros2msg")


def check_both_ways(connection: Connection, root: str, structs: Mapping[str, Any], seed: int) -> None:
    """Re-encode a random message there and back, and hold both to the twin."""
    twin = Twin(structs, root, seed)
    there = transcoder(connection, 2)
    back = transcoder(there.connection, 1)
    assert bytes(there.encode(bytes(twin.ros1))) == twin.cdr
    assert bytes(back.encode(twin.cdr)) == twin.ros1_unnumbered
