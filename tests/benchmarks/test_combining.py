"""What one scan of two lidars costs beside a scan of each. Run it with ``pytest -m benchmark tests/benchmarks``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

import pc2scan
from benchmarks.test_projection import cloud
from pc2scan.bags.destinations import open_writer, plan_destination
from pc2scan.core.rigid import Rigid
from pc2scan.messages.definitions import definition
from pc2scan.messages.pointcloud2 import POINTCLOUD2, PointField, encode_pointcloud2
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import Connection

if TYPE_CHECKING:
    from pathlib import Path

    from pytest_benchmark.fixture import BenchmarkFixture

BEGIN_NS = 1_700_000_000_000_000_000
#: Clouds of each lidar: enough that the start of a conversion takes at most a twentieth of the time.
CLOUDS = 160
TF = "tf2_msgs/msg/TFMessage"


def write_two(path: Path, clouds: int = CLOUDS) -> Path:
    """Two lidars of 131,072 points of 32 bytes at 10 Hz, 37 ms apart, on a robot that drives straight on."""
    x, y, z = cloud(131_072, "organised")
    data = np.zeros((x.size, 8), "<f4")
    for axis, values in enumerate((x, y, z)):
        data[:, axis] = values.ravel()
    points = data.tobytes()
    writer = open_writer(plan_destination(path, compression="none", source_ros_version=2), path, path.name)
    topics = {"/tf_static": TF, "/tf": TF, "/front": POINTCLOUD2, "/rear": POINTCLOUD2}
    handles = {}
    for topic, msgtype in topics.items():
        text, digest = definition(msgtype, 2)
        handles[topic] = writer.add_connection(Connection(0, topic, msgtype, "cdr", text, digest))
    mounts = {"front": Rigid.from_rpy(0, 0, 0, (0.4, 0, 0.5)), "rear": Rigid.from_rpy(0, 0, 3.1, (-0.4, 0, 0.5))}
    static = [("base_link", frame, BEGIN_NS, *mount.pose) for frame, mount in mounts.items()]
    writer.write(handles["/tf_static"], BEGIN_NS, encode_transforms(static, "cdr"), BEGIN_NS)
    fields = [PointField(name, 4 * place, 7) for place, name in enumerate("xyz")]
    for tick in range(clouds * 100 + 50):
        time_ns = BEGIN_NS + tick * 1_000_000
        if tick % 20 == 0:
            moved = Rigid.from_rpy(0, 0, 0, (tick * 0.0015, 0, 0))
            row = ("odom", "base_link", time_ns, *moved.pose)
            writer.write(handles["/tf"], time_ns, encode_transforms([row], "cdr"), time_ns)
        for topic, phase in (("/front", 0), ("/rear", 37)):
            if tick % 100 == phase and tick < clouds * 100:
                message = encode_pointcloud2(
                    serialization="cdr",
                    sequence=0,
                    stamp_ns=time_ns,
                    frame_id=topic.removeprefix("/"),
                    fields=fields,
                    point_step=32,
                    data=points,
                    height=x.shape[0],
                )
                writer.write(handles[topic], time_ns, message, time_ns)
    writer.finish()
    return path


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_two(tmp_path_factory.mktemp("two") / "two.mcap")


def convert_two(source: Path, destination: Path, how: str, heights: str, jobs: int) -> pc2scan.Report:
    """Convert them: a scan of each, one scan, or one scan through a fixed frame."""
    params = pc2scan.ProjectionParams(target_frame="base_link", min_height=-1e6)
    if heights == "a band":
        params = pc2scan.ProjectionParams(target_frame="base_link", min_height=-0.5, max_height=1.0)
    return pc2scan.convert(
        source,
        destination,
        topics=("/front:=/scan", "/rear:=/scan") if how != "a scan of each" else ("/front:=/one", "/rear:=/other"),
        params=params,
        fixed_frame="odom" if "fixed" in how else "",
        only_scans=True,
        overwrite=True,
        jobs=jobs,
    )


@pytest.mark.benchmark
@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("heights", ["all", "a band"])
@pytest.mark.parametrize("how", ["a scan of each", "one scan", "one scan, fixed frame"])
def test_two_lidars(
    benchmark: BenchmarkFixture, source: Path, tmp_path: Path, how: str, heights: str, jobs: int
) -> None:
    benchmark.group = f"two lidars, {heights}, {jobs} jobs"
    report = benchmark(convert_two, source, tmp_path / "scans.mcap", how, heights, jobs)
    assert (
        sum(topic.messages_out for topic in report.topics if topic.action in {"converted", "joined"}) >= 2 * CLOUDS - 1
    )
