"""Clouds as files, read back by pypcd4 and NumPy."""

from __future__ import annotations

import warnings
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.errors import DecodeError, ResultError
from pc2scan.messages.pointcloud2 import PointCloud2, PointField
from support import ROOT
from support.builders import (
    CLOUD,
    SECOND,
    TF,
    Item,
    Recording,
    Stream,
    header,
    item,
    serialized,
    transforms,
    typestore,
    write_mcap,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
START = 1_700_000_000_000_000_000

#: name, NumPy's type, elements, offset: unaligned, with padding, of every datatype.
FIELDS = (
    ("x", "f4", 1, 0),
    ("y", "f4", 1, 4),
    ("z", "f4", 1, 8),
    ("intensity", "f4", 1, 16),
    ("ring", "u2", 1, 20),
    ("normal", "f4", 3, 23),
    ("t", "f8", 1, 40),
    ("tag", "u1", 0, 48),
    ("a", "i1", 1, 49),
    ("b", "i2", 1, 50),
    ("c", "i4", 1, 52),
    ("d", "u4", 1, 56),
)
NAMES = tuple(name for name, *_ in FIELDS)
STEP = 61
_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def content(count: int, seed: int) -> dict[str, Any]:
    """Random values of each field."""
    random = np.random.default_rng(seed)
    values = {}
    for name, kind, elements, _ in FIELDS:
        shape = (count, elements) if elements > 1 else (count,)
        values[name] = (random.uniform(-100, 100, shape) if kind[0] != "u" else random.uniform(0, 100, shape)).astype(
            kind
        )
    values["x"][1] = np.nan
    return values


def cloud(
    ros_version: int,
    seq: int,
    *,
    stamp_ns: int = START,
    frame: str = "lidar",
    big: bool = False,
    padding: int = 0,
    names: Sequence[str] = NAMES,
) -> bytes:
    """Two rows of three points, whose rows may have bytes behind them."""
    order = ">" if big else "<"
    values = content(6, 1)
    row_step = 3 * STEP + padding
    data = np.full(2 * row_step, 0xEE, np.uint8)
    for name, kind, elements, offset in FIELDS:
        size = np.dtype(kind).itemsize
        for point in range(6):
            begin = (point // 3) * row_step + (point % 3) * STEP + offset
            data[begin : begin + size * max(elements, 1)] = np.frombuffer(
                np.atleast_1d(values[name][point]).astype(order + kind).tobytes(), np.uint8
            )
    store = typestore(ros_version)
    kind_of_field = store.types["sensor_msgs/msg/PointField"]
    fields = [
        kind_of_field(name, offset, _CODES[kind], elements)
        for name, (_, kind, elements, offset) in zip(names, FIELDS, strict=True)
    ]
    message = store.types[CLOUD](
        header(store, ros_version, seq, stamp_ns, frame), 2, 3, fields, big, STEP, row_step, data, False
    )
    return serialized(store, message, CLOUD, ros_version)


ONE = {"/points": "lidar"}


def recorded(tmp_path: Path, *, topics: Mapping[str, str] = ONE, stamps: Sequence[int] = (START,), **how: Any) -> Path:
    """Clouds on some topics in some frames, and a transform of the frame lidar."""
    items: list[Item] = []
    streams = [Stream(topic, CLOUD) for topic in topics]
    for i, stamp in enumerate(stamps):
        for stream in streams:
            make = partial(cloud, stamp_ns=stamp, frame=topics[stream.topic], **how)
            items.append(item(stream, START + i, make))
    tf = Stream("/tf_static", TF, latched=True)
    row = ("map", "lidar", START, (1.5, -2.0, 0.25))
    items.insert(0, Item(tf, START - SECOND, {version: transforms([row], version) for version in (1, 2)}))
    return write_mcap(tmp_path / "clouds.mcap", Recording((tf, *streams), tuple(items)))


def read_pcd(path: Path) -> Any:
    pypcd4 = pytest.importorskip("pypcd4")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pypcd4.PointCloud.from_path(path)


@pytest.mark.parametrize("how", [{}, {"padding": 7}, {"big": True, "padding": 64}], ids=str)
def test_pcd_has_every_field_of_every_point(how: dict[str, Any], tmp_path: Path) -> None:
    path = recorded(tmp_path, **how)
    report = pc2scan.export(path, tmp_path / "out", format="pcd", pose_frame="map")
    assert (report.messages, report.exit_status, report.topics[0].base_frame) == (1, 0, "lidar")
    found = read_pcd(tmp_path / "out" / f"{START}.pcd")
    meta = found.metadata
    assert meta.fields == tuple(field[0] for field in FIELDS)
    assert (meta.width, meta.height, meta.points, meta.data.value) == (3, 2, 6, "binary")
    assert meta.viewpoint == (1.5, -2.0, 0.25, 1, 0, 0, 0)
    assert dict(zip(meta.fields, meta.count, strict=True))["normal"] == 3
    for name, values in content(6, 1).items():
        columns = [found.pc_data[f"{name}__{i:04d}"] for i in range(3)] if values.ndim == 2 else [found.pc_data[name]]
        read = np.column_stack(columns).reshape(values.shape)
        assert read.dtype == values.dtype
        assert read.tobytes() == values.tobytes(), name


def test_clouds_of_one_stamp_are_two_files(tmp_path: Path) -> None:
    path = recorded(tmp_path, stamps=(START, START, START + 1))
    pc2scan.export(path, tmp_path / "out", format="pcd")
    names = {entry.name for entry in (tmp_path / "out").glob("*.pcd")}
    assert names == {f"{START}.pcd", f"{START}_1.pcd", f"{START + 1}.pcd"}


@pytest.mark.parametrize(
    ("form", "field", "name", "error"),
    [
        ("pcd", 4, "laser ring", "'laser ring'"),
        ("pcd", 4, "x", "two fields are named 'x'"),
        *(("pcd", 6, name, "no cloud can be written") for name in ("", "_", "a\nDATA ascii")),
        ("kitti", 3, "other", "the cloud has no field with intensities: its fields are x, y, z, other"),
    ],
)
def test_fields_that_a_file_cannot_have_are_refused(
    form: Any, field: int, name: str, error: str, tmp_path: Path
) -> None:
    names = list(NAMES)
    names[field] = name
    with pytest.raises(ResultError, match=error) as caught:
        pc2scan.export(recorded(tmp_path, names=names), tmp_path / "out", format=form)
    assert not (tmp_path / "out").exists()
    assert form != "kitti" or "pcd" in str(caught.value.hint)


def test_fields_that_are_the_same_bytes_many_times_are_refused() -> None:
    fields = tuple(PointField(f"f{i}", 0, 8) for i in range(4000))
    cloud = PointCloud2(0, 0, "", 1, 10, fields, False, 8, 80, memoryview(bytes(80)), True)
    with pytest.raises(DecodeError, match="its fields have 32000 bytes, and a point has 8"):
        cloud.structured_points()
    huge = PointCloud2(0, 0, "", 0, 0, (PointField("x", 0, 7, 1 << 32),), False, 8, 0, memoryview(b""), True)
    with pytest.raises(DecodeError, match="bytes"):
        huge.structured_points()


def test_kitti_has_returns_alone(tmp_path: Path) -> None:
    stamps = (START, START + SECOND // 8)
    path = recorded(tmp_path, stamps=stamps)
    pc2scan.export(path, tmp_path / "out", format="kitti", pose_frame="map")
    values = content(6, 1)
    expected = np.column_stack([values[name] for name in ("x", "y", "z", "intensity")])[[0, 2, 3, 4, 5]]
    for name in ("000000.bin", "000001.bin"):
        found = np.fromfile(tmp_path / "out" / name, np.float32).reshape(-1, 4)
        assert found.tobytes() == expected.astype(np.float32).tobytes()
    assert np.loadtxt(tmp_path / "out" / "times.txt").tolist() == [0.0, 0.125]
    assert (tmp_path / "out" / "stamps.txt").read_text().split() == [str(stamp) for stamp in stamps]
    poses = np.loadtxt(tmp_path / "out" / "poses.txt").reshape(2, 3, 4)
    assert poses[1].tolist() == [[1, 0, 0, 1.5], [0, 1, 0, -2], [0, 0, 1, 0.25]]
