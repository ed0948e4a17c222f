from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

import pc2scan
from pc2scan import check
from pc2scan.core.consumers import CONSUMERS
from pc2scan.errors import RecordingError, TopicError, UsageError
from support import RECORDINGS, ROOT, needs_shared, sampled
from support.builders import IMU, Recording, Stream, imu_message, item, write_mcap
from support.scan_recordings import GOOD, START, STEP, recording, scans, write

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.show.check import Check, TopicCheck

#: Without a preset gmapping places the beams half an increment to the right.
FINE = dict.fromkeys(CONSUMERS, "accepted") | {"gmapping": "shifted"}


def only(found: Check) -> TopicCheck:
    (topic,) = found.topics
    return topic


def kinds(topic: TopicCheck) -> dict[str, str]:
    return {finding.kind: finding.level for finding in topic.findings}


def looked(tmp_path: Path, *content: LaserScan, **options: object) -> TopicCheck:
    return only(check(write(tmp_path / "a.mcap", *content, **options)))


def test_one_scan_in_many_decides(tmp_path: Path) -> None:
    content = scans(6)
    content[3] = replace(content[3], ranges=GOOD.ranges[:7], range_min=-1.0)
    content[4] = replace(content[4], ranges=GOOD.ranges[:8])
    path = write(tmp_path / "a.mcap", *content)
    topic = only(check(path))
    told = {c.consumer: (c.outcome, c.scans, c.stamp_ns) for c in topic.consumers}
    third = START + 3 * STEP
    assert told["slam_toolbox"] == ("ignored", 2, third)
    assert told["gmapping"] == ("ignored", 2, third)
    assert told["cartographer"] == ("aborts", 1, third)
    assert told["amcl"] == ("accepted", 6, START)
    assert kinds(topic)["length"] == "defect"
    verdict = next(c.verdict for c in topic.consumers if c.consumer == "slam_toolbox")
    assert (verdict.observed, verdict.allowed) == ("7 ranges", "9 ranges")


def test_topics_are_looked_at_apart(tmp_path: Path) -> None:
    longer = replace(GOOD, ranges=np.ones(5, np.float32), angle_min=-0.5, angle_max=0.5)
    path = write_mcap(tmp_path / "a.mcap", recording({"/front": scans(3), "/back": scans(2, longer)}))
    found = check(path)
    assert [(topic.topic, topic.scans, topic.beams) for topic in found.topics] == [
        ("/back", 2, (5, 5)),
        ("/front", 3, (9, 9)),
    ]
    assert found.exit_status == 0
    assert [topic.topic for topic in check(path, topics=["front"]).topics] == ["/front"]
    with pytest.raises(TopicError, match="no topic /left"):
        check(path, topics=["/left"])


def test_scans_in_a_frame_that_the_robot_moves_in_are_defects(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    pc2scan.convert(ROOT / "fixtures" / "hall.bag", path, target_frame="odom", min_height=0.1)
    found = check(path, consumers=["slam_toolbox"])
    (moving,) = (each for each in only(found).findings if each.kind == "moving-frame")
    assert "'odom' is one that base_link moves in (by 0.32 m)" in moving.text
    assert "`target_frame=base_link`" in moving.hint
    assert found.exit_status == 1


def test_a_frame_that_nearly_matches(tmp_path: Path) -> None:
    found = only(check(write(tmp_path / "a.mcap", *scans(3, replace(GOOD, frame_id="lasr")))))
    (unknown,) = (each for each in found.findings if each.kind == "frame-unknown")
    assert unknown.hint == "did you mean laser? For scans made from clouds: pc2scan convert `source_frame=laser`"
    (slam,) = (each.verdict for each in found.consumers if each.consumer == "slam_toolbox")
    assert slam.cure == unknown.hint


def test_messages_that_are_no_scans(tmp_path: Path) -> None:
    content = recording({"/scan": scans(3)})
    cut = [
        replace(entry, data={g: data[:50] for g, data in entry.data.items()})
        if entry.stream.topic == "/scan" and entry.log_time_ns > START + STEP
        else entry
        for entry in content.items
    ]
    path = write_mcap(tmp_path / "a.mcap", replace(content, items=tuple(cut)))
    topic = only(check(path))
    assert (topic.scans, kinds(topic)) == (1, {"undecodable": "defect"})
    assert topic.findings[0].count == 2


def test_what_cannot_be_checked(tmp_path: Path) -> None:
    with pytest.raises(RecordingError):
        check(tmp_path / "nothing.bag")
    with pytest.raises(UsageError, match="`consumers` has 'hector'"):
        check(tmp_path / "nothing.bag", consumers=["hector"])
    with pytest.raises(UsageError, match="no recording was given"):
        check([])
    assert check(write(tmp_path / "empty.mcap"), consumers=["amcl"]).exit_status == 1
    stream = Stream("/imu", IMU)
    content = Recording((stream,), (item(stream, START, lambda g, seq: imu_message(g, seq=seq, stamp_ns=START)),))
    with pytest.raises(TopicError, match="no LaserScan topic"):
        check(write_mcap(tmp_path / "a.mcap", content))


@needs_shared
@pytest.mark.parametrize("name", sampled(["luminar_highway.bag", "jarvis_two_lasers.bag", "guardian_pallet.bag"], 1))
def test_scans_of_real_sensors_are_accepted(name: str) -> None:
    found = check(RECORDINGS / name)
    assert {c.outcome for topic in found.topics for c in topic.consumers} <= (
        # It has no transforms, and no return of the simulator is range_max.
        {"ignored", "misplaced"} if name == "luminar_highway.bag" else {"accepted", "shifted"}
    )
    assert found.exit_status == (name == "luminar_highway.bag")
    assert sum(topic.scans for topic in found.topics) >= 5
    told = {kind for topic in found.topics for kind in kinds(topic)}
    assert (
        told
        == {
            "jarvis_two_lasers.bag": {"rate", "ranges-short"},
            "guardian_pallet.bag": {"stamps-far", "ranges-nan", "no-transform", "tilted"},
            "luminar_highway.bag": {"stamps-far", "no-transforms"},
        }[name]
    )


#: The transforms of a recording, the kind of what is wrong, and what cures it: each has a cure of its own.
CURES: dict[str, tuple[tuple[tuple[str, str], ...], bool, str, str]] = {
    "no mount": (
        (("odom", "base_link"),),
        False,
        "frame-unknown",
        "`static_tf='base_link laser X Y Z ROLL PITCH YAW'`",
    ),
    "a namespace": (
        (("robot1/odom", "robot1/base_link"), ("robot1/base_link", "laser")),
        False,
        "no-odometry-frame",
        "`odom_frame=robot1/odom`",
    ),
    "no odometry": ((("base_link", "laser"),), True, "no-odometry-frame", "record the robot's odometry on /tf"),
    "no odometry, but joints": (
        (("base_link", "laser"), ("base_link", "wheel")),
        False,
        "no-odometry-frame",
        "record the robot's odometry on /tf",
    ),
    "no transforms": ((), True, "no-transforms", "`odom_topic` or `trajectory` adds odometry"),
    "another name": (
        (("world", "base_link"), ("base_link", "laser")),
        False,
        "no-odometry-frame",
        "names the right one",
    ),
}


@pytest.mark.parametrize("case", CURES)
def test_each_trouble_with_frames_has_its_own_cure(case: str, tmp_path: Path) -> None:
    tree, static, kind, cure = CURES[case]
    found = only(check(write(tmp_path / "a.mcap", *scans(3), tree=tree, static=static)))
    (about,) = (each for each in found.findings if each.kind == kind)
    assert cure in about.hint
    assert ("the robot does not move in them" in about.text) == case.startswith("no odometry")


def test_transforms_of_another_clock_are_named(tmp_path: Path) -> None:
    late = [replace(scan, stamp_ns=scan.stamp_ns + 90 * 10**9) for scan in scans(3)]
    found = only(check(write(tmp_path / "a.mcap", *late, static=False, delay=-90 * 10**9)))
    (missing,) = (each for each in found.findings if each.kind == "no-transform")
    assert missing.hint == "the clocks differ; for scans made from clouds: pc2scan convert `time_offset=auto`"
    (clock,) = (each for each in found.findings if each.kind == "clock")
    assert "s ahead of those of /tf, compared with" in clock.text
    # Without another clock, a tolerance is no help: consumers have none.
    end = [replace(scan, stamp_ns=scan.stamp_ns + 3 * 10**9) for scan in scans(3)]
    found = only(check(write(tmp_path / "b.mcap", *end, static=False, delay=3 * 10**9)))
    (missing,) = (each for each in found.findings if each.kind == "no-transform")
    assert missing.hint.startswith("record /tf as long as the scans; for scans made from")
