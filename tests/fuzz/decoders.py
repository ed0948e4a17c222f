"""Arbitrary bytes through every decoder of messages and texts: a value, or one of pc2scan's own errors.

Containers are what the campaign is for.

Guided by coverage, by hand (``pip install atheris``), one decoder at a time::

    PYTHONPATH=src:tests python tests/fuzz/decoders.py schema -max_total_time=300

It begins with the small corpus and leaves that as it is; a folder that is named gets what was found to reach new code.
The tests go through the corpus without atheris. The first byte of most inputs selects the ROS version.
"""

from __future__ import annotations

import gc
import pkgutil
import sys
import tempfile
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

import numpy as np

import pc2scan
from fuzz.clouds import project_cloud, project_moving
from pc2scan.errors import Pc2ScanError
from pc2scan.model import Connection, Definition, RawMessage
from support.clouds import COMPRESSED, LIVOX, OLD_CLOUD, VELODYNE
from support.memory_reader import MemoryReader

if TYPE_CHECKING:
    from collections.abc import Callable

CORPUS = Path(__file__).with_name("corpus")

_ENCODINGS = ("ros1msg", "ros2msg")


def _serialization(data: bytes) -> tuple[bytes, str]:
    """The first byte selects the wire format."""
    return data[1:], "ros1" if data[:1] < b"\x80" else "cdr"


def _cloud(data: bytes, kind: str = "") -> None:
    """To a scan; messages of other kinds also to a PointCloud2."""
    from pc2scan import ProjectionParams
    from pc2scan.conversion.cloud_to_scan import CloudToScan
    from pc2scan.request.options import ScanSpec
    from pc2scan.transforms.placing import Placer

    content, serialization = _serialization(data)
    conversion = CloudToScan(ScanSpec(params=ProjectionParams(min_height=-9.0)), Placer())
    place, project = conversion.steps("/points")
    assert place is not None
    conversion.serialise("cdr", project(place(conversion.decoder(serialization, kind)(content))))
    if kind:
        from pc2scan.messages.clouds import CLOUDS
        from pc2scan.messages.pointcloud2 import as_pointcloud2, encode_cloud, recorded_cloud

        points = CLOUDS[kind](serialization)(content)
        recorded_cloud(points).structured_points()
        encode_cloud(as_pointcloud2(points), serialization)


def _multi_echo(data: bytes) -> None:
    from pc2scan.messages.multi_echo import decode_multi_echo

    for echo in ("first", "last", "strongest"):
        decode_multi_echo(*_serialization(data), echo)


def _scan(data: bytes) -> None:
    from pc2scan.messages.laserscan import decode_laserscan, encode_laserscan

    content, serialization = _serialization(data)
    encode_laserscan(decode_laserscan(content, serialization), serialization)


def _transforms(data: bytes) -> None:
    from pc2scan.messages.tfmessage import decode_transforms, encode_transforms
    from pc2scan.transforms.builder import TransformBuilder

    rows = decode_transforms(*_serialization(data))
    builder = TransformBuilder()
    builder.add(rows, static=False)
    built = builder.build()
    assert len(built.infos) <= len(rows)
    encode_transforms(rows, _serialization(data)[1])


def _imu(data: bytes) -> None:
    """Some messages of one length each after the other, and what they tell of up."""
    from pc2scan.transforms.imu import ImuRequest, read_up

    content, serialization = _serialization(data)
    kind = "sensor_msgs/Imu" if serialization == "ros1" else "sensor_msgs/msg/Imu"
    connection = Connection(0, "/imu", kind, serialization)
    size = max(1, len(content) // 4)
    parts = [content[place : place + size] for place in range(0, len(content), size)]
    rows = [(connection.id, place, part) for place, part in enumerate(parts)]
    found = read_up([MemoryReader(Path("made"), [connection], rows)], ImuRequest("/imu"))
    assert np.isfinite(found.directions).all()
    assert len(found.directions) == len(found.stamps_ns)


def _poses(data: bytes) -> None:
    """A pose of each type, and the transform that it becomes."""
    from pc2scan.messages.poses import POSES, decode_pose
    from pc2scan.messages.tfmessage import encode_transforms
    from pc2scan.transforms.builder import TransformBuilder
    from pc2scan.transforms.sources import PoseReading, PoseTopic

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
    from pc2scan.messages.clouds import CLOUDS
    from pc2scan.messages.stamps import move_times, set_stamp, stamp_in

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
    from pc2scan.transforms.robot_model import parse_model

    parse_model(data.decode("utf-8", "surrogateescape"), "/robot_description")


def _trajectory(data: bytes) -> None:
    from pc2scan.transforms.trajectory import load_trajectory

    _file("a.tum", data, lambda path: _ignored(load_trajectory(path, ("odom", "base_link"))))


def _wire(data: bytes) -> None:
    from pc2scan.messages.wire import Cursor

    cursor = Cursor(*_serialization(data))
    cursor.header()
    cursor.string()
    cursor.read("2f")
    cursor.take(*cursor.read("I"))


def _schema(data: bytes) -> None:
    from pc2scan.messages.transcode import transcoder

    encoding = _ENCODINGS[data[0] % len(_ENCODINGS)] if data else ""
    ros_version = 1 if encoding == "ros1msg" else 2
    definition = Definition(encoding, data[1:])
    planned = transcoder(
        Connection(
            1, "/t", "p/T" if ros_version == 1 else "p/msg/T", f"{'ros1' if ros_version == 1 else 'cdr'}", definition
        ),
        3 - ros_version,
    )
    planned.encode(b"\0\1\0\0" + bytes(64))


@cache
def _planned(ros_version: int) -> Callable[[bytes], object]:
    from pc2scan.messages.transcode import transcoder

    text = b"string[] names\nuint8[] bytes\nfloat64[2] pair\nbuiltin_interfaces/Time[] times\nbool b\nstring last\n"
    text = text.replace(b"builtin_interfaces/Time", b"time") if ros_version == 1 else text
    kind, word = ("p/T", "ros1") if ros_version == 1 else ("p/msg/T", "cdr")
    made = transcoder(Connection(1, "/t", kind, word, Definition(f"ros{ros_version}msg", text)), 3 - ros_version)
    return made.encode


def _transcoding(data: bytes) -> None:
    content, serialization = _serialization(data)
    _planned(1 if serialization == "ros1" else 2)(content)


def _file(name: str, data: bytes, read: Callable[[Path], None]) -> None:
    with tempfile.TemporaryDirectory(prefix="pc2scan-fuzz-") as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        read(path)


def _salvage(data: bytes) -> None:
    """Of what is sound, all comes out."""
    import bz2

    import lz4.frame
    import zstandard

    from pc2scan.files.salvage import decompressed_prefix

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


def _ros1_frames(data: bytes) -> None:
    """Whatever is packed can be read by ROS 1."""
    import lz4.frame

    from pc2scan.bags.rosbag1.read import is_readable_lz4
    from pc2scan.bags.rosbag1.write import compress_lz4

    is_readable_lz4(b"\x04\x22\x4d\x18" + data)
    frame = compress_lz4(data)
    assert is_readable_lz4(frame)
    assert lz4.frame.decompress(frame) == data


def _scan_text(data: bytes) -> None:
    from pc2scan.compare.scan_text import open_scan_text, render_scans

    _file("a.txt", data, lambda path: _ignored(render_scans(open_scan_text(path).messages())))


def _qos(data: bytes) -> None:
    from pc2scan.bags.qos import respell_qos
    from pc2scan.bags.topics import latches

    text = data.decode("utf-8", "replace")
    latches(text)
    respell_qos(text)


def _parameters(data: bytes) -> None:
    from pc2scan.request.parameters import resolve
    from pc2scan.request.params_file import load_params_file

    _file("params.yaml", data, lambda path: _ignored(resolve(load_params_file(path).settings)))


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
    "trajectory": _trajectory,
    "wire": _wire,
    "schema": _schema,
    "transcoding": _transcoding,
    "salvage": _salvage,
    "ros1-frames": _ros1_frames,
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


#: Whose code is counted; the last is what rosbags names the code that it makes of definitions.
_COUNTED = {"pc2scan", "mcap", "rosbags", "tmpmod"}


def _instrument(name: str, instrument: Callable[[FunctionType], object]) -> None:
    """Have everything counted that a decoder may reach: also what is imported only where there is damage."""
    for file in sorted((CORPUS / name).iterdir()):
        decode(name, file.read_bytes())
    for module in pkgutil.walk_packages(pc2scan.__path__, "pc2scan."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    for found in gc.get_objects():
        if isinstance(found, FunctionType) and (found.__module__ or "").split(".")[0] in _COUNTED:
            instrument(found)


def main() -> None:
    """Let atheris look for inputs that reach new code."""
    import atheris

    name, *rest = sys.argv[1:]
    _instrument(name, atheris.instrument_func)
    with tempfile.TemporaryDirectory(prefix="pc2scan-fuzz-") as folder:
        # What is found goes to the first folder.
        folders = [argument for argument in rest if not argument.startswith("-")] or [folder]
        options = [argument for argument in rest if argument.startswith("-")]
        atheris.Setup([sys.argv[0], *folders, str(CORPUS / name), *options], lambda data: decode(name, data))
        atheris.Fuzz()


if __name__ == "__main__":
    main()
