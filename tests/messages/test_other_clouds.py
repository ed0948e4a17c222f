"""Recordings without clouds: what they have instead is named, with what makes clouds of it, by every command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from mcap.writer import Writer

import pc2scan
from pc2scan.errors import TopicError
from support.command import run
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Mapping

TABLE = Path(__file__).parent / "other_clouds.txt"


def recording(path: Path, types: Mapping[str, str]) -> Path:
    """Write an MCAP file with these topics; ``X in protobuf`` is a schema in another encoding than ROS's."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        for topic, kind in types.items():
            name, _, encoding = kind.partition(" in ")
            schema = writer.register_schema(name, encoding or "ros2msg", b"")
            channel = writer.register_channel(topic, encoding or "cdr", schema)
            writer.add_message(channel, log_time=10**9, publish_time=10**9, data=b"\0\1\0\0")
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def refused(path: Path, **options: Any) -> TopicError:
    with pytest.raises(TopicError) as caught:
        pc2scan.convert(path, dry_run=True, **options)
    return caught.value


@pytest.mark.parametrize(("types", "what", "advice"), rows(TABLE, "instead"))
def test_what_there_is_instead_of_clouds(types: dict[str, str], what: str, advice: str, tmp_path: Path) -> None:
    error = refused(recording(tmp_path / "a.mcap", types))
    assert error.message == f"the recording has no PointCloud2 topic, but {what}"
    assert advice in (error.hint or "")


@pytest.mark.parametrize(("types", "said", "hint"), rows(TABLE, "nothing"))
def test_no_more_topics_than_a_line_takes(types: dict[str, str], said: str, hint: str | None, tmp_path: Path) -> None:
    error = refused(recording(tmp_path / "a.mcap", types))
    assert (error.message, error.hint) == (f"the recording has no PointCloud2 topic{said}", hint)


def test_a_topic_that_is_named_is_explained(tmp_path: Path) -> None:
    path = recording(tmp_path / "a.mcap", {"/packets": "rslidar_msg/msg/RslidarPacket"})
    error = refused(path, topics="/packets")
    assert error.message == "topic /packets is rslidar_msg/msg/RslidarPacket, not sensor_msgs/msg/PointCloud2"
    assert (error.hint or "").startswith("these are RoboSense packets: play the recording into RoboSense's driver")


def test_info_says_it(tmp_path: Path) -> None:
    path = recording(tmp_path / "a.mcap", {"/packets": "ouster_ros/msg/PacketMsg"})
    done = run("info", path)
    assert done.status == 0
    assert "warning: the recording has no clouds, but Ouster packets: /packets; play the recording into" in done.stderr
