"""How often a conversion decompresses each chunk: ahead of it, in it, and once more with the first clouds of each."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any
from zlib import crc32

import pytest

import pc2scan
from pc2scan.bags.mcap import chunks as mcap_chunks
from pc2scan.bags.mcap.read import McapReader
from pc2scan.bags.rosbag1 import records as rosbag1_records
from pc2scan.bags.rosbag1.read import Rosbag1Reader
from pc2scan.core.rigid import Rigid
from pc2scan.errors import UsageError
from support.worlds.moving import Drive, Lidar, write_imu, write_world

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

TILTING = Drive(speed=0.5, turn=0.2, tilt=0.05)
LIDARS = (
    Lidar("/front", "front", columns=600),
    Lidar("/rear", "rear", columns=600, mount=Rigid.from_rpy(0.0, 0.0, 3.1, (-0.2, 0.0, 0.5)), phase=0.03),
    # Begins late.
    Lidar("/late", "late", columns=400, phase=1.3),
)
IN_BASE: dict[str, Any] = {"target_frame": "base_link", "min_height": 0.1, "max_height": 2.0}
#: Its clock is ahead of the others' by more than a scan of both may be: only later places of the recording tell.
AHEAD = Lidar("/ahead", "ahead", columns=300, clock=3.0)
#: Without transforms it is tilted, which a conversion notices as it goes.
TILTED = Lidar("/tilted", "tilted", columns=300, mount=Rigid.from_rpy(0.0, 0.35, 0.0, (0.2, 0.0, 0.5)))
LEVEL = {"level": True, "imu": "/imu", "static_tf": "base_link imu_link 0.1 0 0.2 0 0 0"}
DESKEWED = {**IN_BASE, "fixed_frame": "odom", "deskew": True}
TOGETHER = {"topics": ["/front:=/scan", "/rear:=/scan", "/late:=/scan"]}

#: Options, and the number of times that the chunk that is read most is decompressed.
REQUESTS: list[tuple[dict[str, Any], int]] = [
    ({"topics": "/front", "min_height": 0.1}, 1),
    ({"topics": "/front", "min_height": 0.1, "start": 20.7, "end": 21.5}, 1),
    # Heights are advised in the robot's frame.
    ({"topics": "/front"}, 2),
    ({"topics": "/front", "scan_time": "auto", "time_increment": "auto", "beams": "auto"}, 2),
    ({"topics": "/front", **IN_BASE}, 2),
    ({"topics": "/front", "source_frame": "fornt", "min_height": 0.1}, 2),
    ({"topics": "/front", **IN_BASE, "scan_time": "auto", "time_increment": "auto", "beams": "auto"}, 2),
    ({"topics": "/front", **DESKEWED, "scan_time": "auto", "beams": "auto"}, 2),
    ({"topics": "/front", **DESKEWED, "point_time": "azimuth:ccw:start"}, 2),
    (
        {"topics": "/front", **DESKEWED, **LEVEL, "scan_time": "auto", "beams": "auto"},
        2,
    ),
    ({"topics": ["/front", "/late"], **DESKEWED, "level": True, "point_time": "azimuth:ccw:start", "start": 20.5}, 2),
    # The stamps of /late are far from its log times: its clock is compared with that of the transforms in the end.
    ({**TOGETHER, **IN_BASE}, 3),
    ({**TOGETHER, **DESKEWED, **LEVEL, "scan_time": "auto", "beams": "auto"}, 2),
    ({**TOGETHER, **DESKEWED, "every": 0.5, "end": 21.5}, 2),
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

    def counted(decompress: Callable[..., Any]) -> Callable[..., Any]:
        def counting(name: str, data: Any, size: int) -> Any:
            counts[crc32(data)] += 1
            return decompress(name, data, size)

        return counting

    for module in (mcap_chunks, rosbag1_records):
        monkeypatch.setattr(module, "decompress", counted(module.decompress))
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


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_clocks_that_differ_are_compared_in_the_one_reading_ahead(
    kind: str, decompressed: Counter[int], tmp_path: Path
) -> None:
    path = write_world(tmp_path / "world.mcap", (LIDARS[0], AHEAD), TILTING)
    drive = tmp_path / f"drive.{kind}"
    pc2scan.convert(path, drive, topics="/front:=/unused", keep_clouds=True, min_height=0.1, compression="lz4")
    decompressed.clear()
    with pytest.raises(UsageError, match="different clocks"):
        pc2scan.convert(drive, tmp_path / "s.mcap", topics=["/front:=/scan", "/ahead:=/scan"], **IN_BASE)
    assert max(decompressed.values()) == 1


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_advice_about_several_tilted_sensors_reads_the_transforms_once(
    kind: str, decompressed: Counter[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    also = Lidar("/also", "also", columns=300, mount=TILTED.mount)
    path = write_world(tmp_path / "world.mcap", (TILTED, also), TILTING)
    drive = tmp_path / f"drive.{kind}"
    pc2scan.convert(path, drive, topics="/tilted:=/unused", keep_clouds=True, min_height=0.1, compression="lz4")
    decompressed.clear()
    indexed: list[Path] = []

    def counting(find: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def counted(reader: Any) -> Any:
            indexed.append(reader.path)
            return find(reader)

        return counted

    for reader in (McapReader, Rosbag1Reader):
        monkeypatch.setattr(reader, "_found_index", counting(reader._found_index))
    report = pc2scan.convert(drive, tmp_path / "s.mcap")
    assert "tilted" in " ".join(report.warnings)
    assert max(decompressed.values()) <= 2 + 2
    # The index is read once: of a damaged recording, that is a reading of everything.
    assert indexed == [drive]


def test_info_reads_each_chunk_once(drive: Path, decompressed: Counter[int]) -> None:
    assert pc2scan.info(drive).proposals
    assert max(decompressed.values()) == 1


def test_scans_in_python_are_made_in_two_readings_as_well(drive: Path, decompressed: Counter[int]) -> None:
    options: dict[str, Any] = {"topics": "/front", **DESKEWED, **LEVEL, "scan_time": "auto", "beams": "auto"}
    assert list(pc2scan.scans(drive, **options))
    assert max(decompressed.values()) <= 2 + 1
