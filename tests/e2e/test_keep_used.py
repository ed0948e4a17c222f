"""``--keep-used``: the points that beams read, as recorded."""

from __future__ import annotations

import math
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.messages.laserscan import decode_laserscan
from pc2scan.messages.pointcloud2 import PointCloud2, PointField, decode_pointcloud2
from support import ROOT, sampled
from support.builders import CLOUD, T0, Item, Recording, Stream, write_mcap
from support.encoded import encode_pointcloud2
from support.tables import rows

TABLES = Path(__file__).with_name("keep_used.txt")
HALL = ROOT / "fixtures" / "hall.mcap"


def messages(path: Path, topic: str) -> list[Any]:
    with closing(open_recording(path)) as reader:
        found = [message for message in reader.messages() if message.connection.topic == topic]
        return [(message.log_time_ns, message.connection.serialization, bytes(message.data)) for message in found]


def clouds(path: Path, topic: str) -> list[PointCloud2]:
    return [decode_pointcloud2(data, serialization) for _, serialization, data in messages(path, topic)]


# Each container once, each choice once, and all pairs in the long run.
@pytest.mark.parametrize(
    ("options", "source"),
    sampled(product([row for (row,) in rows(TABLES, "of one cloud")], ("hall.mcap", "hall.bag", "hall")), 4),
)
def test_the_kept_points_give_the_same_scans(source: str, options: dict[str, Any], tmp_path: Path) -> None:
    """And only they are left, with their own fields."""
    recording, options = HALL.with_name(source), {"min_height": -0.4, "max_height": 1.0, **options}
    kept, again = tmp_path / "kept.mcap", tmp_path / "again.mcap"
    pc2scan.convert(recording, kept, keep_used="/used", keep_clouds=True, jobs=1, **options)
    # In the same places: what is fixed to the recording's frames stays so.
    pc2scan.convert(kept, again, topics="/used:=/scan2", **options)
    scans = messages(kept, "/scan")
    assert scans
    assert messages(again, "/scan2") == scans
    for cloud, used, (_, serialization, data) in zip(
        clouds(kept, "/points"), clouds(kept, "/used"), scans, strict=True
    ):
        assert [field.name for field in used.fields] == [*(field.name for field in cloud.fields), "beam"]
        read = set(np.flatnonzero(np.isfinite(decode_laserscan(data, serialization).ranges)).tolist())
        beams = set(used.field("beam").reshape(-1).tolist())
        # Whether a beam is removed depends on its own range and on those of its neighbours.
        assert beams >= read if "remove" in options else beams == read
        assert_recorded(cloud, used)


def assert_recorded(cloud: PointCloud2, used: PointCloud2) -> None:
    """All points that are kept are in the cloud, byte by byte."""
    assert (used.stamp_ns, used.frame_id) == (cloud.stamp_ns, cloud.frame_id)
    rows = {bytes(row) for row in np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step)}
    own = np.frombuffer(used.data, np.uint8).reshape(-1, used.point_step)
    assert all(bytes(row[: cloud.point_step]) in rows for row in own)


def test_padding_byte_order_and_rows_stay(tmp_path: Path) -> None:
    """A big-endian cloud with gaps, of which a field is called beam already, one has three elements."""
    step = 29
    kind = np.dtype(
        {
            "names": ["y", "x", "beam", "z", "normal"],
            "formats": [">f4", ">f4", ">u2", ">f4", (">f4", 3)],
            "offsets": [1, 5, 9, 12, 16],
            "itemsize": step,
        }
    )
    points = np.frombuffer(np.random.default_rng(1).bytes(6 * step), kind).copy()
    points["x"], points["y"], points["z"] = [1, 2, -3, 4, math.nan, 1], [0.01, 0.01, 1, 0.02, 0, -3], 0.5
    codes = {"y": (7, 1), "x": (7, 1), "beam": (4, 1), "z": (7, 1), "normal": (7, 3)}
    fields = [PointField(name, kind.fields[name][1], *codes[name]) for name in kind.names]  # type: ignore[index,union-attr]
    data = encode_pointcloud2(
        serialization="cdr", sequence=0, stamp_ns=T0, frame_id="lidar", fields=fields, point_step=step,
        data=points.tobytes(), height=2, is_bigendian=True, is_dense=True,
    )  # fmt: skip
    kept = tmp_path / "kept.mcap"
    points_stream = Stream("/points", CLOUD, latched=True)
    source = write_mcap(tmp_path / "a.mcap", Recording((points_stream,), (Item(points_stream, T0, {2: data}),)))
    pc2scan.convert(source, kept, keep_used="/used")
    (used,) = clouds(kept, "/used")
    assert (used.is_bigendian, used.is_dense, used.height, used.width, used.point_step) == (True, True, 1, 3, step + 4)
    assert used.fields == (*fields, PointField("scan_beam", step, 6))
    rows = np.frombuffer(used.data, np.uint8).reshape(3, -1)
    assert rows[:, :step].tobytes() == points[[0, 2, 5]].tobytes()
    assert used.field("scan_beam").reshape(-1).tolist() == [180, 341, 108]
    with closing(open_recording(kept)) as reader:
        connections = {connection.topic: connection for connection in reader.connections}
    assert connections["/used"].qos == connections["/scan"].qos
    assert connections["/used"].latching is connections["/scan"].latching is True
