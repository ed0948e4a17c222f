"""Arbitrary bytes through every decoder of messages and texts: a value, or one of pc2scan's own errors.

Containers are what the campaign is for. The first byte of most inputs selects the ROS version.
"""

from __future__ import annotations

import bz2
import tempfile
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lz4.frame
import numpy as np
import zstandard

from fuzz.clouds import project_cloud, project_moving
from pc2scan import ProjectionParams
from pc2scan.bags.observers import observe
from pc2scan.bags.qos import respell_qos
from pc2scan.bags.topics import latches
from pc2scan.compare.scan_text import open_scan_text, render_scans
from pc2scan.conversion.steps import CloudToScan, serialised
from pc2scan.errors import Pc2ScanError
from pc2scan.files.compression import decompressed_prefix
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import decode_laserscan, encode_laserscan
from pc2scan.messages.multi_echo import decode_multi_echo
from pc2scan.messages.pointcloud2 import as_pointcloud2, encode_cloud, recorded_cloud
from pc2scan.messages.poses import POSES, decode_pose
from pc2scan.messages.stamps import move_times, set_stamp, stamp_in
from pc2scan.messages.tfmessage import decode_transforms, encode_transforms
from pc2scan.messages.transcode import transcoder
from pc2scan.model import Connection, Definition, RawMessage
from pc2scan.request.params_file import load_params_file
from pc2scan.request.precedence import resolve
from pc2scan.request.spec import ScanSpec
from pc2scan.transforms.attitude import ImuReading
from pc2scan.transforms.builder import TransformBuilder
from pc2scan.transforms.placing import Placer
from pc2scan.transforms.sources import PoseReading, PoseTopic
from pc2scan.transforms.static import parse_model
from support.clouds import COMPRESSED, LIVOX, OLD_CLOUD, VELODYNE
from support.memory_reader import MemoryReader

if TYPE_CHECKING:
    from collections.abc import Callable

CORPUS = Path(__file__).with_name("corpus")


def _serialization(data: bytes) -> tuple[bytes, str]:
    """The first byte selects the wire format."""
    return data[1:], "ros1" if data[:1] < b"\x80" else "cdr"


def _cloud(data: bytes, kind: str = "") -> None:
    """To a scan; messages of other kinds also to a PointCloud2."""
    content, serialization = _serialization(data)
    conversion = CloudToScan(ScanSpec(params=ProjectionParams(min_height=-9.0)), Placer())
    place, _, project = conversion.steps("/points")
    assert place is not None
    decode = CLOUDS[kind or "sensor_msgs/msg/PointCloud2"](serialization)
    serialised(encode_laserscan, "cdr", project(place(decode(content))))
    if kind:
        points = CLOUDS[kind](serialization)(content)
        recorded_cloud(points).structured_points()
        encode_cloud(as_pointcloud2(points), serialization)


def _multi_echo(data: bytes) -> None:
    for echo in ("first", "last", "strongest"):
        decode_multi_echo(*_serialization(data), echo)


def _scan(data: bytes) -> None:
    content, serialization = _serialization(data)
    encode_laserscan(decode_laserscan(content, serialization), serialization)


def _transforms(data: bytes) -> None:
    rows = decode_transforms(*_serialization(data))
    builder = TransformBuilder()
    builder.add(rows, static=False)
    built = builder.build()
    assert len(built.infos) <= len(rows)
    encode_transforms(rows, _serialization(data)[1])


def _imu(data: bytes) -> None:
    """Some messages of one length each after the other, and what they tell of up."""
    content, serialization = _serialization(data)
    kind = "sensor_msgs/Imu" if serialization == "ros1" else "sensor_msgs/msg/Imu"
    connection = Connection(0, "/imu", kind, serialization)
    size = max(1, len(content) // 4)
    parts = [content[place : place + size] for place in range(0, len(content), size)]
    rows = [(connection.id, place, part) for place, part in enumerate(parts)]
    reader = MemoryReader(Path("made"), [connection], rows)
    reading = ImuReading([reader], "/imu")
    observe((reader, reading.observers(reader)))
    found = reading.up()
    assert np.isfinite(found.directions).all()
    assert len(found.directions) == len(found.stamps_ns)


def _poses(data: bytes) -> None:
    """A pose of each type, and the transform that it becomes."""
    content, serialization = _serialization(data)
    for kind in POSES:
        connection = Connection(0, "/odom", kind, serialization)
        reading = PoseReading(PoseTopic("/odom"), [connection])
        reading.add(RawMessage(connection, 0, content, 0))
        found, _ = reading.finish()
        for each in found:
            builder = TransformBuilder()
            builder.add_poses(each.parent, each.child, each.stamps_ns, each.poses)
            builder.build()
    encode_transforms([decode_pose(content, serialization)], serialization)


def _stamps(data: bytes) -> None:
    """A message keeps everything but its times; what cannot be decoded is not changed in part."""
    content, serialization = _serialization(data)
    for kind in CLOUDS:
        copy = bytearray(content)
        stamp_in(copy, serialization)
        with suppress(Pc2ScanError):
            move_times(copy, serialization, kind, 10**18, ("x",))
        set_stamp(copy, serialization, 10**18)
        assert len(copy) == len(content)
        assert stamp_in(copy, serialization) == 10**18


def _model(data: bytes) -> None:
    parse_model(data.decode("utf-8", "surrogateescape"), "/robot_description")


def _schema(data: bytes) -> None:
    _transcoder(1 + data[0] % 2 if data else 2, data[1:]).encode(b"\0\1\0\0" + bytes(64))


@cache
def _transcoder(ros_version: int, text: bytes) -> Any:
    kind, word = ("p/T", "ros1") if ros_version == 1 else ("p/msg/T", "cdr")
    definition = Definition(f"ros{ros_version}msg", text)
    return transcoder(Connection(1, "/t", kind, word, definition), 3 - ros_version)


#: A definition of all kinds of fields.
_TEXT = b"string[] names\nuint8[] bytes\nfloat64[2] pair\nbuiltin_interfaces/Time[] times\nbool b\nstring last\n"


def _transcoding(data: bytes) -> None:
    content, serialization = _serialization(data)
    text = _TEXT.replace(b"builtin_interfaces/Time", b"time") if serialization == "ros1" else _TEXT
    _transcoder(1 if serialization == "ros1" else 2, text).encode(content)


def _file(name: str, data: bytes, read: Callable[[Path], None]) -> None:
    with tempfile.TemporaryDirectory(prefix="pc2scan-fuzz-") as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        read(path)


def _salvage(data: bytes) -> None:
    """Of what is sound, all comes out."""
    kinds: dict[str, tuple[bytes, Callable[[], Any]]] = {
        "bz2": (b"BZh", bz2.BZ2Decompressor),
        "lz4": (b"\x04\x22\x4d\x18", lz4.frame.LZ4FrameDecompressor),
        "zstd": (b"\x28\xb5\x2f\xfd", zstandard.ZstdDecompressor().decompressobj),
    }
    kind = sorted(kinds)[data[0] % 3] if data else "lz4"
    magic, make = kinds[kind]
    found = decompressed_prefix(magic + data[1:], kind, 1_000)
    decoder = make()
    try:
        whole = decoder.decompress(magic + data[1:])
    except (OSError, EOFError, RuntimeError, MemoryError, zstandard.ZstdError):
        return
    if decoder.eof:
        assert found == whole[: 16 << 20]


def _scan_text(data: bytes) -> None:
    _file("a.txt", data, lambda path: _ignored(render_scans(open_scan_text(path).messages())))


def _qos(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    latches(text)
    respell_qos(text)


def _parameters(data: bytes) -> None:
    _file("params.yaml", data, lambda path: _ignored(resolve([load_params_file(path).options])))


def _ignored(_: object) -> None:
    """A value that only had to come about."""


DECODERS: dict[str, Callable[[bytes], None]] = {
    "cloud": _cloud,
    "clouds": project_cloud,
    "moving": project_moving,
    "livox": partial(_cloud, kind=LIVOX[1]),
    "compressed": partial(_cloud, kind=COMPRESSED),
    "pointcloud": partial(_cloud, kind=OLD_CLOUD),
    "velodyne": partial(_cloud, kind=VELODYNE),
    "scan": _scan,
    "multi-echo": _multi_echo,
    "transforms": _transforms,
    "imu": _imu,
    "poses": _poses,
    "stamps": _stamps,
    "model": _model,
    "schema": _schema,
    "transcoding": _transcoding,
    "salvage": _salvage,
    "qos": _qos,
    "parameters": _parameters,
    "scan-text": _scan_text,
}


def decode(name: str, data: bytes) -> None:
    """Run one decoder; its errors are what it is for, and anything else is a bug."""
    try:
        DECODERS[name](data)
    except Pc2ScanError as err:
        err.args  # noqa: B018  # an error like any other
