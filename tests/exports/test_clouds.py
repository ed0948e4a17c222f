"""Clouds as files, read back by pypcd4 and NumPy."""

from __future__ import annotations

import warnings
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.errors import ResultError
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
    from collections.abc import Sequence
    from pathlib import Path

START = 1_700_000_000_000_000_000

#: The fields of a point: unaligned, with padding, of every datatype.
LAYOUT = {
    "x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 16), "ring": ("u2", 20), "normal": ("3f4", 23),
    "t": ("f8", 40), "tag": ("u1", 48), "a": ("i1", 49), "b": ("i2", 50), "c": ("i4", 52), "d": ("u4", 56),
}  # fmt: skip
NAMES = tuple(LAYOUT)
POINT = np.dtype(
    {"names": NAMES, "formats": [f for f, _ in LAYOUT.values()], "offsets": [o for _, o in LAYOUT.values()]}
    | {"itemsize": 61}
)  # type: ignore[call-overload]
_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def content() -> Any:
    """Six points with random values, one of them without a return."""
    points = np.zeros(6, POINT)
    random = np.random.default_rng(1)
    for name in NAMES:
        points[name] = random.uniform(0, 100, points[name].shape)
    points["x"][1] = np.nan
    return points


def cloud(
    ros_version: int, seq: int, *, stamp_ns: int = START, big: bool = False, padding: int = 0, names: Any = NAMES
) -> bytes:
    """Two rows of three points, whose rows may have bytes behind them."""
    points = content().astype(POINT.newbyteorder(">" if big else "<"))
    rows = np.frombuffer(points.tobytes(), np.uint8).reshape(2, -1)
    data = np.hstack([rows, np.full((2, padding), 0xEE, np.uint8)])
    store = typestore(ros_version)
    kind_of_field = store.types["sensor_msgs/msg/PointField"]
    fields = [
        kind_of_field(name, offset, _CODES[kind[-2:]], int(kind[:-2] or 1))
        for name, (kind, offset) in zip(names, LAYOUT.values(), strict=True)
    ]
    head = header(store, ros_version, seq, stamp_ns, "lidar")
    message = store.types[CLOUD](head, 2, 3, fields, big, POINT.itemsize, data.shape[1], data.ravel(), False)
    return serialized(store, message, CLOUD, ros_version)


def recorded(tmp_path: Path, stamps: Sequence[int] = (START,), **how: Any) -> Path:
    """Clouds, and a transform of their frame."""
    points, tf = Stream("/points", CLOUD), Stream("/tf_static", TF, latched=True)
    row = ("map", "lidar", START, (1.5, -2.0, 0.25))
    items = [Item(tf, START - SECOND, {version: transforms([row], version) for version in (1, 2)})]
    items += [item(points, START + i, partial(cloud, stamp_ns=stamp, **how)) for i, stamp in enumerate(stamps)]
    return write_mcap(tmp_path / "clouds.mcap", Recording((tf, points), tuple(items)))


def read_pcd(path: Path) -> Any:
    pypcd4 = pytest.importorskip("pypcd4", reason="pypcd4 reads PCD files")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pypcd4.PointCloud.from_path(path)


@pytest.mark.slow
@pytest.mark.parametrize("how", [{}, {"padding": 7}, {"big": True, "padding": 64}], ids=str)
def test_pcd_has_every_field_of_every_point(how: dict[str, Any], tmp_path: Path) -> None:
    path = recorded(tmp_path, **how)
    report = pc2scan.export(path, tmp_path / "out", format="pcd", pose_frame="map")
    assert (report.messages, report.exit_status, report.topics[0].base_frame) == (1, 0, "lidar")
    found = read_pcd(tmp_path / "out" / f"{START}.pcd")
    meta = found.metadata
    assert meta.fields == NAMES
    assert (meta.width, meta.height, meta.points, meta.data.value) == (3, 2, 6, "binary")
    assert meta.viewpoint == (1.5, -2.0, 0.25, 1, 0, 0, 0)
    values = content()
    for name in NAMES:
        columns = [f"{name}__{i:04d}" for i in range(3)] if name == "normal" else [name]
        read = np.column_stack([found.pc_data[column] for column in columns]).reshape(values[name].shape)
        assert read.dtype == values[name].dtype
        assert read.tobytes() == values[name].tobytes(), name


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


def test_kitti_has_returns_alone(tmp_path: Path) -> None:
    stamps = (START, START + SECOND // 8)
    path = recorded(tmp_path, stamps)
    pc2scan.export(path, tmp_path / "out", format="kitti", pose_frame="map")
    values = content()
    expected = np.column_stack([values[name] for name in ("x", "y", "z", "intensity")])[[0, 2, 3, 4, 5]]
    for name in ("000000.bin", "000001.bin"):
        found = np.fromfile(tmp_path / "out" / name, np.float32).reshape(-1, 4)
        assert found.tobytes() == expected.astype(np.float32).tobytes()
    assert np.loadtxt(tmp_path / "out" / "times.txt").tolist() == [0.0, 0.125]
    assert (tmp_path / "out" / "stamps.txt").read_text().split() == [str(stamp) for stamp in stamps]
    poses = np.loadtxt(tmp_path / "out" / "poses.txt").reshape(2, 3, 4)
    assert poses[1].tolist() == [[1, 0, 0, 1.5], [0, 1, 0, -2], [0, 0, 1, 0.25]]
