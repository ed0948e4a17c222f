"""Kinds of clouds besides PointCloud2: held to rosbags' encoding of their definitions, and to PointCloud2.

Not ours: rosbags serialises the messages, Python's gzip and zstandard compress them, Draco's C++ library encodes clouds
as the plugin does (``draco.cpp``), and velodyne-decoder, Velodyne's manual and Nebula's cloud of the same packets say
what packets mean.
"""

from __future__ import annotations

import base64
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.errors import DecodeError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.pointcloud2 import recorded_cloud
from support import builders, clouds
from support.builders import CLOUD, NEW, SECOND, T0, Mcap, Recording, Stream
from support.clouds import COMPRESSED, COMPRESSORS, DRACO, OLD_CLOUD, VELODYNE, draco_points
from support.outputs import opened

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.points import Points

SERIALIZATIONS = {1: "ros1", 2: "cdr"}
FORMS = {"ros1.bag": 1, "ros1.mcap": 1, "ros2.mcap": 2}


def decoded(kind: str, data: bytes, ros_version: int) -> Points:
    return CLOUDS[kind](SERIALIZATIONS[ros_version])(data)


def recorded(path: Path, kind: str, messages: Sequence[bytes], ros_version: int, topic: str = "/lidar") -> Path:
    """A recording of messages, a tenth of a second apart."""
    stream = Stream(topic, kind)
    items = tuple(
        builders.Item(stream, T0 + step * SECOND // 10, dict.fromkeys((1, 2), data))
        for step, data in enumerate(messages)
    )
    path.parent.mkdir(exist_ok=True)
    recording = Recording((stream,), items)
    if path.suffix == ".bag":
        return builders.write_rosbag1(path, recording)
    return builders.write_mcap(path, recording, Mcap(ros_version=ros_version, profile=f"ros{ros_version}"))


def scans_of(source: Path, **options: Any) -> list[tuple[int, bytes]]:
    options = {"min_height": -3.0, "max_height": 3.0, "range_min": 0.1, **options}
    report = pc2scan.convert(source, source.with_name(f"scans{source.suffix}"), overwrite=True, **options)
    return [(each.log_time_ns, each.data) for each in opened(Path(report.destination)).of("/scan")]


def _compressed(name: str, points: NDArray[Any], ros_version: int, stamp_ns: int) -> bytes:
    return clouds.compressed(points, ros_version, name, stamp_ns=stamp_ns)


LOSSLESS: dict[str, tuple[str, Callable[[NDArray[Any], int, int], bytes]]] = {
    "PointCloud": (OLD_CLOUD, lambda points, ros, at: clouds.old_cloud(points, ros, stamp_ns=at)),
    **{name: (COMPRESSED, partial(_compressed, name)) for name in COMPRESSORS},
    "a new type": (NEW, lambda points, ros, at: clouds.structured(points, ros, stamp_ns=at)),
}


@pytest.fixture(autouse=True)
def a_new_type_is_one_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CLOUDS, NEW, CLOUDS[CLOUD])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", LOSSLESS)
def test_scans_are_those_of_the_same_points_as_pointcloud2(name: str, form: str, tmp_path: Path) -> None:
    kind, make = LOSSLESS[name]
    ros_version = FORMS[form]
    steps = [
        (T0 + step * SECOND // 10, clouds.lidar_points(step, count)) for step, count in enumerate((300, 1, 0, 299))
    ]
    own = [make(points, ros_version, at) for at, points in steps]
    usual = [clouds.structured(points, ros_version, stamp_ns=at) for at, points in steps]
    options = {"intensity_field": "intensity", "where": "ring != 3"}
    found = scans_of(recorded(tmp_path / "own" / form, kind, own, ros_version), **options)
    assert len(found) == 4
    assert found == scans_of(recorded(tmp_path / "usual" / form, CLOUD, usual, ros_version), **options)


def sound(ros_version: int) -> dict[str, tuple[str, bytes]]:
    """A message of each kind."""
    made = {name: (kind, make(clouds.lidar_points(1, 20), ros_version, T0)) for name, (kind, make) in LOSSLESS.items()}
    made["velodyne"] = VELODYNE, clouds.velodyne([(T0, clouds.packet(0, [500] * 32, 7))] * 2, ros_version)
    return made


@pytest.mark.parametrize("ros_version", [1, 2])
@pytest.mark.parametrize("name", [*LOSSLESS, "velodyne"])
def test_messages_that_end_too_early_are_errors(name: str, ros_version: int) -> None:
    kind, data = sound(ros_version)[name]
    # A CompressedPointCloud2 may end before its format: the first version of the message did.
    formatless = len(data) - len(COMPRESSORS[name][0]) - 4 - (ros_version == 2) if name in COMPRESSORS else -1
    for size in range(0, len(data), 7 if name == "velodyne" else 1):
        if formatless - 3 <= size <= formatless:
            continue
        with pytest.raises(DecodeError):
            decoded(kind, data[:size], ros_version)
    assert len(decoded(kind, data, ros_version).field("x"))


def bomb(name: str) -> Callable[[], bytes]:
    """What packs 50 MiB, when a test needs it: it takes a third of a second."""
    return lambda: COMPRESSORS[name][1](bytes(50 << 20))


DAMAGED: dict[str, tuple[dict[str, Any], str]] = {
    "cut gzip": ({"compressor": "zlib", "data": b"\x1f\x8b\x08\x00"}, "cannot be decompressed with zlib"),
    "no gzip": ({"compressor": "zlib", "data": b"nothing"}, "cannot be decompressed with zlib"),
    "cut zstd": ({"data": COMPRESSORS["zstd"][1](bytes(9999))[:-5]}, "cannot be decompressed with zstd"),
    "cut stream": ({"data": COMPRESSORS["zstd stream"][1](bytes(9999))[:-5]}, "with zstd: .*did not decompress"),
    "nothing": ({"data": b""}, "data has 0 bytes"),
    "fewer points": ({"data": COMPRESSORS["zstd"][1](bytes(100))}, "data has 100 bytes"),
    "bomb": ({"data": bomb("zstd")}, r"are larger than 33,\d+,\d+ bytes"),
    "stream bomb": ({"data": bomb("zstd stream")}, "with zstd: .*did not decompress full frame"),
    "gzip bomb": ({"compressor": "zlib", "data": bomb("zlib")}, "are larger than"),
    "cloudini": ({"form": "cloudini"}, "compressed with 'cloudini'; zlib, zstd and draco are read"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_data_that_cannot_be_decompressed_are_errors(name: str) -> None:
    changes, message = DAMAGED[name]
    made = {key: value() if callable(value) else value for key, value in changes.items()}
    data = clouds.compressed(clouds.lidar_points(0, 20), 2, **made)
    with pytest.raises(DecodeError, match=message) as caught:
        decoded(COMPRESSED, data, 2).xyz()
    assert caught.value.stamp_ns == T0
    if name == "cloudini":
        assert "cloudini_rosbag_converter" in (caught.value.hint or "")


# --- Draco ---


def encoded() -> dict[str, bytes]:
    pytest.importorskip("DracoPy")
    lines = DRACO.read_text("ascii").split()
    return {name: base64.b64decode(text) for name, text in zip(lines[::2], lines[1::2], strict=True)}


@pytest.mark.parametrize("ros_version", [1, 2])
@pytest.mark.parametrize("name", ["exact", "merged", "rounded"])
def test_draco_keeps_the_points_that_were_not_lost(name: str, ros_version: int) -> None:
    points = draco_points()
    data = clouds.compressed(points, ros_version, data=encoded()[name], form="draco")
    found = recorded_cloud(decoded(COMPRESSED, data, ros_version))
    table = np.sort(found.structured_points(), order=("tag", "ring"))
    expected = np.sort(points if name == "exact" else np.unique(points), order=("tag", "ring"))
    assert len(table) == len(expected) == {"exact": 60, "merged": 54, "rounded": 54}[name]
    for field in ("ring", "tag"):
        np.testing.assert_array_equal(table[field], expected[field])
    for axis in "xyz":
        if name == "rounded":
            assert 0 < np.abs(table[axis] - expected[axis]).max() < 18 / 2**14
        else:
            np.testing.assert_array_equal(table[axis], expected[axis])


@pytest.mark.parametrize("place", [0, 7, 11, 12, 24, 31, 35, 36, 37, 39])
def test_draco_that_declares_too_much_is_an_error(place: int) -> None:
    """Numbers in its head: of metadata, points, attributes and their components."""
    damaged = bytearray(encoded()["exact"])
    damaged[place : place + 4] = b"\xff\xff\xff\x3f"
    with pytest.raises(DecodeError):
        decoded(COMPRESSED, clouds.compressed(draco_points(), 2, data=bytes(damaged), form="draco"), 2)


# --- Packets ---


def packets_of(steps: int = 24) -> list[tuple[int, bytes]]:
    """Packets of a wall around a VLP-16."""
    pytest.importorskip("velodyne_decoder")
    return [
        (
            T0 + step * 1_327_104,
            clouds.packet(480 * step, [1500 + 10 * step + laser for laser in range(32)], 1327 * step),
        )
        for step in range(steps)
    ]


def library_points(packets: Sequence[tuple[int, bytes]]) -> NDArray[Any]:
    """The points that the vendor-neutral package makes, with absolute times."""
    import velodyne_decoder

    made = [velodyne_decoder.VelodynePacket(at / 1e9, data) for at, data in packets]
    stamp, points = velodyne_decoder.ScanDecoder().decode(velodyne_decoder.PacketVector(made), as_pcl_structs=True)
    assert abs(stamp.host - packets[-1][0] / 1e9) < 1e-5
    return np.asarray(points)


@pytest.mark.parametrize("form", FORMS)
def test_scans_of_packets_are_those_of_the_packages_points(form: str, tmp_path: Path) -> None:
    ros_version, packets = FORMS[form], packets_of()
    own = recorded(tmp_path / "own" / form, VELODYNE, [clouds.velodyne(packets, ros_version)], ros_version)
    points = library_points(packets)
    usual = recorded(tmp_path / "usual" / form, CLOUD, [clouds.structured(points, ros_version)], ros_version)
    found = scans_of(own, intensity_field="intensity", source_frame="lidar")
    assert found == scans_of(usual, intensity_field="intensity", source_frame="lidar")
    times = decoded(VELODYNE, clouds.velodyne(packets, ros_version), ros_version).field("time")
    np.testing.assert_allclose(times, points["time"] + (packets[-1][0] - T0) / 1e9, atol=2e-6)
    assert times.min() > -1e-4


# --- Which topics ---
