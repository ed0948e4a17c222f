"""Scans of several messages in the simulated world, by the real command: every return is on the wall that it hit."""

from __future__ import annotations

import json
import warnings
from contextlib import closing
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import LaserScan, decode_laserscan
from support import sampled
from support.command import run
from support.worlds.moving import BEGIN_NS, Drive, Lidar, off_the_walls, returns_in_odom, write_world

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

DRIVE = Drive()
FRONT = Lidar("/front", "front", Rigid.from_rpy(0.0, 0.0, 0.0, (0.4, 0.0, 0.5)))
REAR = Lidar("/rear", "rear", Rigid.from_rpy(0.0, 0.0, 3.0, (-0.4, 0.1, 0.6)), phase=0.037)
TOP = Lidar("/top", "top", Rigid.from_rpy(0.0, 0.02, 1.0, (0.0, 0.0, 0.9)), period=0.05, phase=0.011)
FLAT = Lidar("/flat", "flat", Rigid.from_rpy(0.0, 0.0, -1.2, (0.1, -0.3, 0.4)), kind="flat", phase=0.061, columns=1440)

#: Fine beams, whose middles are where the message says.
FINE_BEAMS = ("--geometry", "centered", "--beams", "2880", "--only-scans")
FINE = (*FINE_BEAMS, "--min-height", "0.1")
#: Scans of a robot that moves; and the same without any correction of its motion, for comparison.
MOVED = ("--target-frame", "base_link", "--fixed-frame", "odom")
UNMOVED = ("--target-frame", "base_link")
#: `two_topics` and `MOVED`, and where the floor ends, for Python.
BOTH: dict[str, Any] = {
    "topics": ["/front:=/scan", "/rear:=/scan"],
    "target_frame": "base_link",
    "fixed_frame": "odom",
    "min_height": 0.1,
}


class Done(NamedTuple):
    """What the command said and wrote."""

    stdout: str
    stderr: str
    scans: list[LaserScan]
    log_times: list[int]
    report: dict[str, Any]

    def topic(self, name: str) -> dict[str, Any]:
        """The report's entry of a source topic."""
        (entry,) = (each for each in self.report["topics"] if each["topic"] == name)
        return dict(entry)


def converted(source: Path, *options: str, jobs: str = "2", status: Sequence[int] = (0,)) -> Done:
    folder = source.parent
    done = run(
        "convert", source, "-o", folder / "out.mcap", "--overwrite", "--jobs", jobs, "--report", folder / "r.json",
        *options,
    )  # fmt: skip
    assert done.status in status, done.stderr
    if done.status:
        return Done(done.stdout, done.stderr, [], [], {})
    with closing(open_recording(folder / "out.mcap")) as reader:
        messages = [m for m in reader.messages() if m.connection.ros_type.endswith("LaserScan")]
        scans = [decode_laserscan(m.data, m.connection.serialization) for m in messages]
    return Done(
        done.stdout, done.stderr, scans, [m.log_time_ns for m in messages], json.loads((folder / "r.json").read_text())
    )


def errors(scans: Sequence[LaserScan], drive: Drive = DRIVE, mount: Rigid | None = None) -> Any:
    """How far the returns of scans are from the walls, metres."""
    return np.concatenate([off_the_walls(returns_in_odom(scan, drive, mount)) for scan in scans])


def misplaced(scans: Sequence[LaserScan], drive: Drive = DRIVE, mount: Rigid | None = None) -> float:
    """The share of returns that are off the walls by more than half the width of their beam, and a millimetre.

    A beam stands for every direction within half its width, so not even exact scans are nearer. The millimetre is for
    float32 and for poses that are interpolated between those of the odometry.
    """
    widths = np.concatenate([scan.ranges[np.isfinite(scan.ranges)] * scan.angle_increment for scan in scans])
    return float(np.mean(errors(scans, drive, mount) > widths / 2 + 0.001))


def two_topics(*others: str) -> tuple[str, ...]:
    return tuple(word for topic in ("/front", "/rear", *others) for word in ("--topic", f"{topic}:=/scan"))


def test_two_lidars_become_one_scan(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=1.5)
    done = converted(source, *two_topics(), *MOVED, "--deskew", *FINE)
    assert len(done.scans) == 15
    assert all(scan.frame_id == "base_link" and scan.time_increment == 0 for scan in done.scans)
    assert [scan.stamp_ns for scan in done.scans] == [BEGIN_NS + number * 100_000_000 for number in range(15)]
    assert done.log_times == sorted(done.log_times)
    right = errors(done.scans)
    # 1800 directions of each, but for the first scan.
    assert right.size > 15 * 2400
    assert misplaced(done.scans) == 0
    assert np.max(right) < 0.02
    plain = converted(source, *two_topics(), *UNMOVED, *FINE).scans
    assert misplaced(plain) > 0.7
    assert np.percentile(errors(plain), 95) > 0.1
    rear = done.topic("/rear")
    assert rear["action"] == "joined"
    assert rear["joined"]["used"] == rear["messages_out"] == 14
    assert rear["joined"]["scans_without"] == 1
    assert done.topic("/front")["messages_out"] == 15


def test_three_lidars_of_different_rates_and_a_scanner_become_one_scan(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR, TOP, FLAT], seconds=1.0)
    done = converted(source, *two_topics("/top", "/flat"), *MOVED, "--deskew", *FINE)
    assert len(done.scans) == 10
    assert misplaced(done.scans) == 0
    assert misplaced(converted(source, *two_topics("/top", "/flat"), *UNMOVED, *FINE).scans) > 0.8
    top = done.topic("/top")["joined"]
    assert (top["messages"], top["used"], top["unmatched"]) == (19, 10, 9)
    assert "9 of 19 messages of /top are in no scan on /scan" in done.stdout
    assert done.topic("/flat")["joined"]["used"] == 9


def test_another_topic_may_lead(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=0.8)
    done = converted(source, *two_topics(), *MOVED, *FINE, "--lead", "/rear", "--window", "60ms")
    assert [scan.stamp_ns for scan in done.scans] == [BEGIN_NS + (37 + 100 * n) * 1_000_000 for n in range(7)]
    assert done.topic("/front")["action"] == "joined"
    assert done.topic("/front")["joined"]["used"] == 7


def test_packets_become_full_turns(tmp_path: Path) -> None:
    lidar = Lidar(kind="packets", columns=1800, jitter=0.004)
    source = write_world(tmp_path / "w.mcap", [lidar], seconds=1.0)
    turns = ("--every", "0.1", "--accumulate", "0.1")
    done = converted(source, *MOVED, "--deskew", *FINE, *turns)
    assert len(done.scans) == 10
    full = done.scans[1:-1]
    assert all(np.isfinite(scan.ranges).sum() > 0.6 * len(scan.ranges) for scan in full)
    assert misplaced(done.scans) == 0
    assert misplaced(converted(source, *UNMOVED, *FINE, *turns).scans) > 0.7
    assert all(scan.scan_time == pytest.approx(0.1) for scan in done.scans)
    entry = done.topic("/points")
    assert entry["messages_in"] == 100 == entry["joined"]["used"]
    assert entry["messages_out"] == len(done.scans)
    # As they are, packets make scans of a tenth of a turn.
    single = converted(source, *FINE).scans
    assert len(single) == 100
    assert max(np.isfinite(scan.ranges).sum() for scan in single) < 0.15 * len(single[0].ranges)


def test_a_pattern_that_does_not_come_back_becomes_dense(tmp_path: Path) -> None:
    lidar = Lidar(kind="rosette", columns=400)
    source = write_world(tmp_path / "w.mcap", [lidar], seconds=2.0)
    options = ("--geometry", "centered", "--beams", "1440", "--min-height", "0.1", "--only-scans", "--deskew")
    single = converted(source, *MOVED, *options).scans
    done = converted(source, *MOVED, *options, "--accumulate", "1")
    assert len(done.scans) == len(single) == 20
    seen = [[int(np.isfinite(scan.ranges).sum()) for scan in scans[10:]] for scans in (single, done.scans)]
    assert np.median(seen[1]) > 1.7 * np.median(seen[0])
    assert misplaced(done.scans) == 0
    assert np.max(errors(done.scans)) < 0.02
    # The same without the fixed frame is smeared over what the robot moved in a second.
    smeared = converted(source, *options[:-1], *UNMOVED, "--accumulate", "1")
    assert misplaced(smeared.scans) > 0.7
    # The last ten clouds are those of the last second.
    counted = converted(source, *MOVED, *options, "--accumulate", "10clouds")
    assert [scan.ranges.tobytes() for scan in counted.scans] == [scan.ranges.tobytes() for scan in done.scans]


def test_a_scanner_with_a_varying_number_of_beams_gets_a_constant_one(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FLAT], seconds=1.5)
    with closing(open_recording(source)) as reader:
        before = [decode_laserscan(m.data, "cdr") for m in reader.messages() if m.connection.topic == "/flat"]
    assert len({len(scan.ranges) for scan in before}) > 1
    rebin = ("--rebin", "--preset", "slam_toolbox", "--beams", "720")
    done = converted(source, *rebin, "--fixed-frame", "odom", "--deskew")
    assert len(done.scans) == len(before) == 14
    assert {len(scan.ranges) for scan in done.scans} == {720}
    assert {scan.frame_id for scan in done.scans} == {"flat"}
    assert [scan.stamp_ns for scan in done.scans] == [scan.stamp_ns for scan in before]
    # Half as many beams as were measured: in each, the nearest of two.
    assert misplaced(done.scans, DRIVE, FLAT.mount) == 0
    assert np.mean(errors(done.scans, DRIVE, FLAT.mount) < 0.02) > 0.98
    for scan in done.scans:
        lit = scan.intensities[np.isfinite(scan.ranges)]
        assert set(lit.tolist()) == {10.0, 20.0, 30.0, 40.0}
        assert np.isfinite(scan.ranges).sum() > 600
    beams = done.topic("/flat")["rebinned"]
    assert beams["beams"] > 2 * 600 * 14
    assert beams["shared"] == beams["beams"] - sum(int(np.isfinite(scan.ranges).sum()) for scan in done.scans)
    assert f"of {beams['beams']:,} beams {beams['shared']:,} share one of the new scans" in " ".join(
        done.stdout.split()
    )
    assert done.topic("/flat")["target"] == "/flat"
    assert "refuse" not in done.stderr
    assert misplaced(converted(source, *rebin).scans, DRIVE, FLAT.mount) > 0.7


def test_several_scanners_become_one_scan_in_another_frame(tmp_path: Path) -> None:
    other = Lidar("/flat2", "flat2", Rigid.from_rpy(0.0, 0.0, 2.0, (-0.3, 0.2, 0.4)), kind="flat", columns=1440)
    source = write_world(tmp_path / "w.mcap", [FLAT, other], seconds=1.0)
    options = ("--rebin", "--topic", "/flat:=/scan", "--topic", "/flat2:=/scan", *FINE_BEAMS)
    done = converted(source, *options, *MOVED, "--deskew")
    assert len(done.scans) == 9
    assert misplaced(done.scans) == 0
    assert misplaced(converted(source, *options, *UNMOVED).scans) > 0.8
    assert done.topic("/flat")["points"]["height"] == 0


@pytest.mark.parametrize("jobs", ["2", "5"])
@pytest.mark.parametrize(
    "options",
    sampled(
        [
            [*two_topics("/flat"), *MOVED, "--deskew"],
            ["--topic", "/front", *MOVED, "--accumulate", "0.3"],
            [*two_topics(), *MOVED, "--every", "0.25"],
            ["--rebin"],
        ],
        1,
    ),
)
def test_any_number_of_jobs_gives_the_same_bytes(options: list[str], jobs: str, tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR, FLAT], seconds=0.5)
    found = set()
    for each in ("1", jobs):
        converted(source, *options, jobs=each)
        found.add((tmp_path / "out.mcap").read_bytes())
    assert len(found) == 1


@pytest.mark.parametrize(
    ("phase", "options"),
    sampled(
        product((0.037, 0.063), ({}, {"deskew": True}, {"reduce": "max"}, {"intensity_field": "intensity"})),
        1,
    ),
)
def test_points_that_wait_are_those_that_were_read(
    phase: float, options: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    front = Lidar("/front", "front", FRONT.mount, columns=4000)
    rear = Lidar("/rear", "rear", REAR.mount, columns=4000, phase=phase)
    source = write_world(tmp_path / "w.mcap", [front, rear], seconds=1.0, compression="none")
    found = set()
    for held in (64 << 20, 0):
        monkeypatch.setattr("pc2scan.files.borrowed._MAX_KEPT", held)
        for jobs in (1, 3):
            done = pc2scan.convert(source, tmp_path / "out.mcap", jobs=jobs, overwrite=True, **BOTH, **options)
            found.add((tmp_path / "out.mcap").read_bytes())
    assert len(found) == 1
    assert sum(topic.messages_out for topic in done.topics if topic.target == "/scan") >= 18


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--topic", "/front", "--every", "100", *MOVED), "--every is 100 s, but the recording takes 1.49 s; if"),
        (("--topic", "/front", "--accumulate", "500", *MOVED), "if milliseconds were meant: --accumulate 500ms"),
        ((*two_topics(), "--target-frame", "base_link", "--window", "50"), "if milliseconds were meant: --window 50ms"),
        (
            (*two_topics(), "--target-frame", "base_link", "--window", "1"),
            "messages of /front come every 0.1 s; if mil",
        ),
        (
            (*two_topics(), "--target-frame", "base_link", "--fixed-frame", "base_link"),
            "--fixed-frame is base_link, the frame of the scans itself: no point is moved; --fixed-frame odom",
        ),
        (
            ("--topic", "/front", "--deskew", "--fixed-frame", "base_link"),
            "--fixed-frame is base_link, and front never moves in it: no point is moved; --fixed-frame odom",
        ),
    ],
)
def test_probable_mistakes_draw_a_warning(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=0.5)
    done = converted(source, "--min-height", "0.1", *options)
    assert said in " ".join(done.stderr.split())


@pytest.mark.parametrize("name", sampled(["every", "accumulate"], 1))
def test_milliseconds_as_seconds_are_noticed_in_long_recordings(tmp_path: Path, name: str) -> None:
    source = write_world(tmp_path / "w.mcap", [Lidar("/front", "front", columns=20, elevations=(0.0,))], seconds=40)
    options = ("--topic", "/front", *MOVED, "--min-height", "0.1")
    said = " ".join(converted(source, f"--{name}", "35", *options).stderr.split())
    assert f"--{name} is 35 s, but messages of /front come every 0.1 s: 350 in a scan; if millisec" in said
    assert f"--{name} 35ms" in said
    assert "milliseconds" not in converted(source, f"--{name}", "20", *options).stderr


def test_correct_options_draw_none_of_these_warnings(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=0.5)
    for options in (
        ("--topic", "/front", "--every", "100ms", *MOVED),
        (*two_topics(), *MOVED, "--window", "0.1"),
        ("--topic", "/front", "--deskew", "--fixed-frame", "odom"),
    ):
        done = converted(source, "--min-height", "0.1", *options)
        assert "milliseconds" not in done.stderr
        assert "no point is moved" not in done.stderr


def test_a_gap_of_the_odometry_is_reported_without_deskewing(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT], seconds=0.6, odometry_hz=3)
    options = ("--target-frame", "base_link", "--fixed-frame", "odom", "--accumulate", "0.3")
    done = converted(source, *options)
    assert "transforms to --fixed-frame were missing for up to 0.333 s" in " ".join(done.stderr.split())
    assert done.topic("/front")["motion"]["longest_gap_s"] == pytest.approx(1 / 3, abs=1e-6)


def test_a_box_that_moves_with_regard_to_a_deskewed_lidar_draws_a_warning(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT], seconds=0.3)
    options = ("--deskew", "--fixed-frame", "odom", "--exclude-box")
    said = converted(source, *options, "odom 6 8 -7 7 0 3", "--target-frame", "base_link").stderr
    assert "--exclude-box is in odom, in which front moves, but it rejects points where they were recorded" in said
    assert (
        "recorded" not in converted(source, *options, "base_link -1 1 -1 1 0 1", "--target-frame", "base_link").stderr
    )


def test_a_frame_that_is_not_there_is_named_as_it_was_typed(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT], seconds=0.3)
    said = converted(source, "--deskew", "--fixed-frame", "odm", status=(2,)).stderr
    assert "--fixed-frame is 'odm', which is in no transform; the 3 frames with transforms are base_link" in said
    assert "did you mean odom?" in said
    said = converted(source, "--min-height", "0.1", "--exclude-box", "base_lnk -1 1 -1 1 -1 1", status=(1,)).stderr
    assert "the frame of --exclude-box: no transform has the frame 'base_lnk'" in said
    assert "did you mean base_link?" in said


def test_other_clocks_are_an_error_that_says_by_how_much(tmp_path: Path) -> None:
    ahead = Lidar("/rear", "rear", REAR.mount, clock=42.0)
    source = write_world(tmp_path / "w.mcap", [FRONT, ahead], seconds=1.0)
    said = converted(source, *two_topics(), "--target-frame", "base_link", status=(2,)).stderr
    said = " ".join(said.split())
    assert "the stamps of /rear are 42 s ahead of those of /front" in said
    assert "--topic /rear:=/scan_2" in said
    slightly = Lidar("/rear", "rear", REAR.mount, clock=0.6)
    source = write_world(tmp_path / "slightly.mcap", [FRONT, slightly], seconds=2.0)
    said = " ".join(converted(source, *two_topics(), "--target-frame", "base_link").stderr.split())
    assert "the stamps of /rear are 0.6 s ahead of those of /front" in said
    # No driver is so quick that its messages are logged before their stamps.
    source = write_world(tmp_path / "less.mcap", [FRONT, replace(ahead, clock=0.25)], seconds=0.5)
    said = " ".join(converted(source, *two_topics(), "--target-frame", "base_link").stderr.split())
    assert "the stamps of /rear are 0.25 s ahead of those of /front" in said
    assert "are logged 0.148 s before their stamps, so their clocks differ" in said
    behind = write_world(tmp_path / "late.mcap", [FRONT, replace(ahead, clock=-0.25)], seconds=0.5)
    assert "the stamps of" not in converted(behind, *two_topics(), "--target-frame", "base_link").stderr


def test_a_silent_lidar_is_reported(tmp_path: Path) -> None:
    front = write_world(tmp_path / "front.mcap", [FRONT], seconds=3.0)
    rear = write_world(tmp_path / "rear.mcap", [REAR], seconds=1.0)
    done = run("convert", front, rear, "-o", tmp_path / "o.mcap", *two_topics(), *MOVED, "--min-height", "0.1")
    assert done.status == 0, done.stderr
    assert "21 scans on /scan have nothing of /rear; 21 in a row" in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (two_topics(), "which needs a frame for the points of all: --target-frame"),
        (("--lead", "/front"), "--lead and --window need several topics that become one scan"),
        (("--window", "1"), "--lead and --window need several topics that become one scan"),
        (("--accumulate", "soon"), "--accumulate is 'soon', which is not a time"),
        (("--accumulate", "0clouds"), "it must be 1 to"),
        (("--every", "-1"), "it must be more than 0"),
        (("--accumulate", "1", "--time-increment", "auto"), "a scan of several messages has one time"),
        ((*two_topics(), "--target-frame", "base_link", "--lead", "/points"), "no topic /points"),
        (("--rebin", "--reverse"), "make scans, but --reverse makes clouds"),
        (("--rebin", "--topic", "/front"), "topic /front is sensor_msgs/msg/PointCloud2"),
        (("--fixed-frame", "odom"), "--fixed-frame needs --deskew or --level of clouds, --accumulate, or topics"),
        (("--topic", "/flat", "--min-height", "0"), "--rebin"),
    ],
)
def test_impossible_combinations_are_wrong_usage(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR, FLAT], seconds=0.3)
    done = converted(source, *options, status=(2,))
    assert said in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--accumulate", "1clouds"), "--accumulate 1clouds has no effect"),
        (("--accumulate", "0.2"), "as if the robot had not moved; with odometry: --fixed-frame odom"),
        (("--rebin", "--fixed-frame", "odom"), "--fixed-frame has no effect"),
    ],
)
def test_options_without_effect_draw_a_warning(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, FLAT], seconds=0.4)
    done = converted(source, *options, "--min-height=-1")
    assert said in " ".join(done.stderr.split())


def test_a_frame_that_levels_has_an_effect(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FLAT], Drive(tilt=float(np.radians(3.0))), seconds=0.4)
    done = converted(source, "--rebin", "--level", "--fixed-frame", "odom", "--min-height=-1")
    assert "no effect" not in done.stderr
    assert "level by odom" in done.stdout


def test_pages_of_scans_of_several_clouds_are_refused_with_what_to_do(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, FLAT], seconds=0.4)
    gathered = ("--topic", "/front", "--accumulate", "0.2", *MOVED, "--min-height", "0.1")
    for options in (gathered, ("--rebin",)):
        done = run("view", source, "-o", tmp_path / "v.html", *options)
        assert done.status == 2, done
        assert "make the scans with `pc2scan convert` and these options" in " ".join(done.stderr.split())
        assert not (tmp_path / "v.html").exists()


@pytest.mark.parametrize(
    "options",
    sampled(
        [
            {"topics": ["/front:=/scan", "/rear:=/scan"], "lead": "/rear", "window": "60ms"},
            {"topics": ["/front:=/scan", "/rear:=/scan", "/flat:=/scan"], "deskew": True, "fixed_frame": "odom"},
            {"topics": ["/front:=/a", "/rear:=/a", "/front:=/b"], "fixed_frame": "odom"},
            {"topics": "/front", "accumulate": 0.3, "fixed_frame": "odom"},
            {"topics": "/front:=/s", "every": "250ms", "level": True, "fixed_frame": "odom"},
            {"topics": "/flat", "rebin": True, "preset": "slam_toolbox"},
        ],
        2,
    ),
)
def test_scans_exports_and_maps_are_those_of_the_conversion(tmp_path: Path, options: dict[str, Any]) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR, FLAT], seconds=1.0)
    if not options.get("rebin"):
        options = {"target_frame": "base_link", "min_height": 0.1, **options}
    converted = tmp_path / "out.mcap"
    # Other messages that follow the last cloud make the log time of the last scan later.
    report = pc2scan.convert(source, converted, **options, only_scans=True)
    topics = sorted({topic.target for topic in report.topics if topic.action == "converted" and topic.target})
    expected = list(pc2scan.scans(converted, topics))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scans = pc2scan.scans(source, **options)
        for _ in range(2):
            made = list(scans)
            assert [(s.topic, s.log_time_ns, s.stamp_ns, s.frame) for s in made] == [
                (s.topic, s.log_time_ns, s.stamp_ns, s.frame) for s in expected
            ]
            assert [s.ranges.tobytes() for s in made] == [s.ranges.tobytes() for s in expected]
            assert [s.intensities.tobytes() for s in made] == [s.intensities.tobytes() for s in expected]
        assert set(scans.topics) == set(topics)
        assert len(made) > 3
        if len(topics) == 1:
            pc2scan.export(source, tmp_path / "direct.npz", **options)
            pc2scan.export(converted, tmp_path / "after.npz", topics=topics)
            with np.load(tmp_path / "direct.npz") as direct, np.load(tmp_path / "after.npz") as after:
                assert set(direct) == set(after)
                assert all(direct[name].tobytes() == after[name].tobytes() for name in after)
            direct_map = pc2scan.map(source, **options)
            after_map = pc2scan.map(converted, topics=topics, tf_from=source)
            assert direct_map.scans == after_map.scans
            assert direct_map.cells.tobytes() == after_map.cells.tobytes()


def test_the_command_takes_the_same_words_for_exports_and_maps(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=0.8)
    options = (*two_topics(), "--target-frame", "base_link", "--min-height", "0.1", "--window", "60ms")
    for command in (("export", source, "-o", tmp_path / "s.npz"), ("map", source, "-o", tmp_path / "m.yaml")):
        done = run(*command, *options)
        assert done.status == 0, done.stderr
        assert "/scan" in done.stdout
        assert "1 scan on /scan has nothing of /rear" in done.stderr + done.stdout
    # Options without effect are refused, as in a conversion.
    done = run(
        "export", source, "-o", tmp_path / "t.npz", "--topic", "/front", "--window", "0.1", "--min-height", "0.1"
    )
    assert done.status == 2


def test_level_scans_of_two_lidars_on_a_robot_that_tilts(tmp_path: Path) -> None:
    drive = Drive(tilt=float(np.radians(3.0)))
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], drive, seconds=1.0)
    done = converted(source, *two_topics(), *MOVED, "--deskew", "--level", *FINE)
    assert {scan.frame_id for scan in done.scans} == {"base_link_stabilized"}
    # The level frame has the yaw and the place of the robot, and none of its tilt.
    assert misplaced(done.scans) == 0
    with closing(open_recording(tmp_path / "out.mcap")) as reader:
        kinds = [message.connection.topic for message in reader.messages()]
    assert kinds.count("/tf") == kinds.count("/scan") == 10
    # Without it, floor is in the scans: far from any wall.
    tilted = errors(converted(source, *two_topics(), *MOVED, "--deskew", *FINE).scans, drive)
    assert np.mean(tilted > 0.1) > 0.01


def test_a_dry_run_says_what_becomes_of_the_topics(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=0.5)
    done = run("convert", source, "-n", *two_topics(), *MOVED, "--min-height", "0.1")
    assert done.status == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert ["/front", "/scan", "5", "5", "-", "converted"] in lines
    assert ["/rear", "/scan", "4", "4", "-", "joined"] in lines
    done = run("convert", source, "-n", "--topic", "/front", *MOVED, "--every", "0.7", "--min-height", "0.1")
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("/front")]
    assert line.split()[2:4] in (["5", "2"], ["5", "3"])


def test_python_takes_the_same_words(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=0.8)
    typed = converted(source, *two_topics(), *MOVED, "--lead", "/rear", "--window", "60ms", "--min-height", "0.1")
    report = pc2scan.convert(
        source,
        tmp_path / "python.mcap",
        lead="/rear",
        window=0.06,
        **BOTH,
    )
    assert (tmp_path / "python.mcap").read_bytes() == (tmp_path / "out.mcap").read_bytes()
    (front,) = [topic for topic in report.topics if topic.topic == "/front"]
    assert front.joined is not None
    assert front.joined.as_dict() == typed.topic("/front")["joined"]


def test_a_file_of_several_outputs_may_put_sources_together(tmp_path: Path) -> None:
    source = write_world(tmp_path / "w.mcap", [FRONT, REAR], seconds=0.8)
    scans = {
        "/both": {
            "sources": ["/front", "/rear"], "target_frame": "base_link", "fixed_frame": "odom", "min_height": 0.1,
        },
        "/front_scan": {"sources": "/front", "min_height": 0.1},
        "/dense": {"sources": "/rear", "min_height": 0.1, "accumulate": "3clouds", "fixed_frame": "odom"},
    }  # fmt: skip
    (tmp_path / "scans.json").write_text(json.dumps({"scans": scans}))
    done = converted(source, "--scans", str(tmp_path / "scans.json"))
    out = {(topic["topic"], topic["target"]): topic["messages_out"] for topic in done.report["topics"]}
    assert out["/front", "/both"] == out["/front", "/front_scan"] == 8
    assert out["/rear", "/both"] == out["/rear", "/dense"] == 7
    alone = converted(source, *two_topics(), *MOVED, "--min-height", "0.1")
    both = [scan for scan in done.scans if scan.frame_id == "base_link"]
    assert [scan.ranges.tobytes() for scan in both] == [scan.ranges.tobytes() for scan in alone.scans]
