"""The simulated world: what its robots measure lies on its walls, if it is placed rightly."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.core.rigid import Rigid
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from support.worlds.moving import BEGIN_NS, Drive, Lidar, off_the_walls, write_world

if TYPE_CHECKING:
    from pathlib import Path

TILTED = Drive(tilt=np.radians(3.0))
MOUNT = Rigid.from_rpy(0.02, -0.1, 2.0, (0.3, -0.2, 0.6))


@pytest.mark.parametrize("kind", ["turning", "packets", "rosette"])
def test_each_return_is_on_a_wall_or_the_floor_at_its_own_time(tmp_path: Path, kind: str) -> None:
    lidar = Lidar(kind=kind, mount=MOUNT, columns=400)
    path = write_world(tmp_path / "w.mcap", [lidar], TILTED, seconds=0.3)
    decode = CLOUDS[POINTCLOUD2]("cdr")
    seen = 0
    with closing(open_recording(path)) as reader:
        clouds = [decode(m.data) for m in reader.messages() if m.connection.topic == "/points"]
    assert len(clouds) == (30 if kind == "packets" else 3)
    for cloud in clouds:
        points = np.stack(cloud.xyz(), axis=1).astype(np.float64)
        begin = (cloud.stamp_ns - BEGIN_NS) / 1e9
        for point, time in zip(points[::50], cloud.field("t")[::50], strict=True):
            (placed,) = TILTED.pose(begin + time / 1e9).compose(MOUNT).apply(point[np.newaxis])
            assert min(off_the_walls(placed[np.newaxis, :2])[0], abs(placed[2])) < 1e-5
            seen += 1
    assert seen > 20
