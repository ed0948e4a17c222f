"""How often a conversion decompresses each chunk: ahead of it, in it, and once more with the first clouds of each."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any
from zlib import crc32

import pytest

import pc2scan
from pc2scan.core.rigid import Rigid
from pc2scan.files.compression import decompress
from support.worlds.moving import Drive, Lidar, write_imu, write_world

if TYPE_CHECKING:
    from pathlib import Path

TILTING = Drive(speed=0.5, turn=0.2, tilt=0.05)
LIDARS = (
    Lidar("/front", "front", columns=600),
    Lidar("/rear", "rear", columns=600, mount=Rigid.from_rpy(0.0, 0.0, 3.1, (-0.2, 0.0, 0.5)), phase=0.03),
    # Begins late.
    Lidar("/late", "late", columns=400, phase=1.3),
)
IN_BASE: dict[str, Any] = {"target_frame": "base_link", "min_height": 0.1, "max_height": 2.0}
LEVEL = {"level": True, "imu": "/imu", "static_tf": "base_link imu_link 0.1 0 0.2 0 0 0"}
DESKEWED = {**IN_BASE, "fixed_frame": "odom", "deskew": True}
TOGETHER = {"topics": ["/front:=/scan", "/rear:=/scan", "/late:=/scan"]}

#: Options, and the number of times that the chunk that is read most is decompressed.
REQUESTS: list[tuple[dict[str, Any], int]] = [
    ({"topics": "/front", "min_height": 0.1}, 1),
    # Heights are advised in the robot's frame.
    ({"topics": "/front"}, 2),
    ({"topics": "/front", **DESKEWED, "scan_time": "auto", "beams": "auto"}, 2),
    # The stamps of /late are far from its log times: its clock is compared with that of the transforms in the end.
    ({**TOGETHER, **IN_BASE}, 3),
    ({**TOGETHER, **DESKEWED, **LEVEL, "scan_time": "auto", "beams": "auto"}, 2),
]


@pytest.fixture(scope="module", params=["mcap", "bag"])
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One recording with everything, in many chunks."""
    folder = tmp_path_factory.mktemp("drive")
    world = write_world(folder / "world.mcap", LIDARS, TILTING)
    imu = write_imu(folder / "imu.mcap", TILTING, Rigid.from_rpy(0.0, 0.0, 0.0, (0.1, 0.0, 0.2)))
    path = folder / f"drive.{request.param}"
    pc2scan.convert(
        [world, imu], path, topics="/late:=/unused", keep_clouds=True, min_height=0.1, compression="lz4", drop="/unused"
    )
    return path


@pytest.fixture
def decompressed(monkeypatch: pytest.MonkeyPatch) -> Counter[int]:
    """How often each chunk is decompressed, by the CRC-32 of what is stored."""
    counts: Counter[int] = Counter()

    def counting(compression: str, stored: Any, records: Any) -> None:
        counts[crc32(stored)] += 1
        decompress(compression, stored, records)

    monkeypatch.setattr("pc2scan.bags.chunks.decompress", counting)
    return counts


@pytest.mark.parametrize(("options", "most"), REQUESTS, ids=map(str, range(len(REQUESTS))))
def test_no_chunk_is_decompressed_too_often(
    drive: Path, options: dict[str, Any], most: int, decompressed: Counter[int], tmp_path: Path
) -> None:
    report = pc2scan.convert(drive, tmp_path / "scans.mcap", **options)
    assert any(topic.messages_out for topic in report.topics if topic.spec is not None)
    assert len(decompressed) > 2
    # A survey reads the first clouds, and those of each topic are judged before anything is written.
    topics = {topic.topic for topic in report.topics if topic.spec is not None}
    assert max(decompressed.values()) <= most + 1 + len(topics)
