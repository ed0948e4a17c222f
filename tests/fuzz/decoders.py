"""Arbitrary bytes through every decoder: what comes out is a value, or one of pc2scan's own errors.

Guided by coverage, by hand (``pip install atheris``), one decoder at a time::

    PYTHONPATH=src:tests python tests/fuzz/decoders.py schema tests/fuzz/corpus/schema -max_total_time=300

The small corpus is gone through by the tests, without atheris.
"""

from __future__ import annotations

import sqlite3
import sys
import tempfile
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags.model import Connection, Definition
from pc2scan.bags.rosbag1_records import Damaged, parsed_connection, parsed_fields
from pc2scan.errors import Pc2ScanError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["CORPUS", "DECODERS", "decode"]

CORPUS = Path(__file__).with_name("corpus")

_ENCODINGS = ("ros1msg", "ros2msg", "ros2idl")


def _serialization(data: bytes) -> tuple[bytes, str]:
    """The first byte tells the wire format."""
    return data[1:], "ros1" if data[:1] < b"\x80" else "cdr"


def _cloud(data: bytes) -> None:
    from pc2scan import ProjectionParams
    from pc2scan.pipeline.cloud_to_scan import CloudToScan
    from pc2scan.pipeline.frames import Frames

    content, serialization = _serialization(data)
    CloudToScan(ProjectionParams(min_height=-9.0), Frames())(content, serialization, "cdr")


def _scan(data: bytes) -> None:
    from pc2scan.messages.laserscan import decode_laserscan, encode_laserscan

    content, serialization = _serialization(data)
    encode_laserscan(decode_laserscan(content, serialization), serialization)


def _transforms(data: bytes) -> None:
    from pc2scan.messages.tfmessage import decode_transforms, encode_transforms
    from pc2scan.tf.buffer import TransformBuilder

    rows = decode_transforms(*_serialization(data))
    builder = TransformBuilder()
    builder.add(rows, static=False)
    built = builder.build()
    assert len(built.infos) <= len(rows)
    encode_transforms(rows, _serialization(data)[1])


def _wire(data: bytes) -> None:
    from pc2scan.messages.wire import Cursor

    cursor = Cursor(*_serialization(data))
    cursor.header()
    cursor.string()
    cursor.float32s(2)
    cursor.take(cursor.uint32())


def _schema(data: bytes) -> None:
    from pc2scan.messages.transcode import transcoder

    encoding = _ENCODINGS[data[0] % 3] if data else ""
    generation = 1 if encoding == "ros1msg" else 2
    definition = Definition(encoding, data[1:])
    planned = transcoder(
        Connection(
            1, "/t", "p/T" if generation == 1 else "p/msg/T", f"{'ros1' if generation == 1 else 'cdr'}", definition
        ),
        3 - generation,
    )
    planned.encode(b"\0\1\0\0" + bytes(64))


@cache
def _planned(generation: int) -> Callable[[bytes], object]:
    from pc2scan.messages.transcode import transcoder

    text = b"string[] names\nuint8[] bytes\nfloat64[2] pair\nbuiltin_interfaces/Time[] times\nbool b\nstring last\n"
    text = text.replace(b"builtin_interfaces/Time", b"time") if generation == 1 else text
    kind, word = ("p/T", "ros1") if generation == 1 else ("p/msg/T", "cdr")
    made = transcoder(Connection(1, "/t", kind, word, Definition(f"ros{generation}msg", text)), 3 - generation)
    return made.encode


def _transcoding(data: bytes) -> None:
    content, serialization = _serialization(data)
    _planned(1 if serialization == "ros1" else 2)(content)


def _records(data: bytes) -> None:
    try:
        fields = parsed_fields(data)
        parsed_connection(fields, fields.get(b"body", b""))
    except Damaged:
        return


def _file(name: str, data: bytes, read: Callable[[Path], None]) -> None:
    with tempfile.TemporaryDirectory(prefix="pc2scan-fuzz-") as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        read(path)


def _recording(path: Path) -> None:
    from pc2scan.bags.registry import open_recording

    with closing(open_recording(path)) as reader:
        for message in reader.messages():
            bytes(message.data)
        list(reader.attachments())
        list(reader.metadata())


def _bag(data: bytes) -> None:
    _file("a.bag", b"#ROSBAG V2.0\n" + data, _recording)


def _mcap(data: bytes) -> None:
    _file("a.mcap", b"\x89MCAP0\r\n" + data, _recording)


def _salvage(data: bytes) -> None:
    from pc2scan.bags.salvage import decompressed_prefix

    kinds = {"lz4": b"\x04\x22\x4d\x18", "bz2": b"BZh", "zstd": b"\x28\xb5\x2f\xfd"}
    kind = sorted(kinds)[data[0] % 3] if data else "lz4"
    decompressed_prefix(kinds[kind] + data[1:], kind, 1_000)


def _rows(data: bytes) -> None:
    """Values of any kind in a database's columns."""
    parts = [*data.split(b"\xfe"), *([b""] * 6)]
    kinds: list[Callable[[bytes], object]] = [bytes, lambda b: b.decode("utf-8", "replace"), len, lambda _: None]
    values = [kinds[part[0] % 4](part[1:]) if part else None for part in parts[:6]]

    def read(path: Path) -> None:
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("CREATE TABLE topics(id, name, type, serialization_format, offered_qos_profiles)")
            database.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
            database.execute("INSERT INTO topics VALUES (1, ?, ?, 'cdr', ?)", values[:3])
            database.execute("INSERT INTO messages VALUES (1, 1, ?, ?)", values[3:5])
        _recording(path)

    with tempfile.TemporaryDirectory(prefix="pc2scan-fuzz-") as folder:
        read(Path(folder, "a.db3"))


def _metadata(data: bytes) -> None:
    from pc2scan.bags.damage import DamageLog
    from pc2scan.bags.rosbag2_metadata import read_info

    _file("metadata.yaml", data, lambda path: _ignored(read_info(path.parent, DamageLog())))


def _qos(data: bytes) -> None:
    from pc2scan.bags.qos import latches, respelled_qos

    text = data.decode("utf-8", "replace")
    latches(text)
    respelled_qos(text, by_name=True)


def _parameters(data: bytes) -> None:
    from pc2scan.pipeline.parameters import resolve
    from pc2scan.pipeline.params_file import load_params_file

    _file("params.yaml", data, lambda path: _ignored(resolve(load_params_file(path).settings)))


def _ignored(_: object) -> None:
    """A value that only had to come about."""


DECODERS: dict[str, Callable[[bytes], None]] = {
    "cloud": _cloud,
    "scan": _scan,
    "transforms": _transforms,
    "wire": _wire,
    "schema": _schema,
    "transcoding": _transcoding,
    "records": _records,
    "bag": _bag,
    "mcap": _mcap,
    "salvage": _salvage,
    "rows": _rows,
    "metadata": _metadata,
    "qos": _qos,
    "parameters": _parameters,
}


def decode(name: str, data: bytes) -> None:
    """Run one decoder; its errors are what it is for, and anything else is a bug."""
    try:
        DECODERS[name](data)
    except Pc2ScanError as err:
        err.args  # noqa: B018  # an error like any other


def main() -> None:
    """Let atheris look for inputs that reach new code."""
    import atheris

    name, *rest = sys.argv[1:]
    # What a decoder imports when it is first used is what is to be covered.
    for file in sorted((CORPUS / name).iterdir()):
        decode(name, file.read_bytes())
    atheris.instrument_all()
    atheris.Setup([sys.argv[0], *rest], lambda data: decode(name, data))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
