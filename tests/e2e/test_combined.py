"""Scans of several messages in the simulated world, by the real command: every return is on the wall that it hit."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import decode_laserscan
from support import conversions, sampled
from support.builders import CHATTER, SECOND, Item, Recording, string, write_mcap
from support.command import run
from support.tables import rows
from support.worlds.moving import BEGIN_NS, Drive, Lidar, off_the_walls, returns_in_odom, write_world

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.messages.laserscan import LaserScan
    from support.conversions import Made

TABLES = Path(__file__).with_name("combined.txt")
FRONT = Lidar("/front", "front", Rigid.from_rpy(0.0, 0.0, 0.0, (0.4, 0.0, 0.5)))
REAR = Lidar("/rear", "rear", Rigid.from_rpy(0.0, 0.0, 3.0, (-0.4, 0.1, 0.6)), phase=0.037)
TOP = Lidar("/top", "top", Rigid.from_rpy(0.0, 0.02, 1.0, (0.0, 0.0, 0.9)), period=0.05, phase=0.011)
FLAT = Lidar("/flat", "flat", Rigid.from_rpy(0.0, 0.0, -1.2, (0.1, -0.3, 0.4)), kind="flat", phase=0.061, columns=1440)
FLAT2 = Lidar("/flat2", "flat2", Rigid.from_rpy(0.0, 0.0, 2.0, (-0.3, 0.2, 0.4)), kind="flat", columns=1440)
PACKETS = Lidar("/front", kind="packets", columns=1800, jitter=0.004)
#: The same with few points, where only what is said counts.
SMALL_FRONT, SMALL_REAR, SMALL_FLAT = (replace(each, columns=60) for each in (FRONT, REAR, FLAT))
TILTING = Drive(tilt=float(np.radians(3.0)))

#: Fine beams, whose middles are where the message says.
FINE_BEAMS = ("--geometry", "centered", "--beams", "2880", "--only-scans")
FINE = (*FINE_BEAMS, "--min-height", "0.1")
#: Scans of a robot that moves; and the same without any correction of its motion, for comparison.
MOVED = ("--target-frame", "base_link", "--fixed-frame", "odom")
UNMOVED = ("--target-frame", "base_link")
#: `TWO` and `MOVED`, and where the floor ends, for Python.
BOTH: dict[str, Any] = {
    "topics": ["/front:=/scan", "/rear:=/scan"],
    "target_frame": "base_link",
    "fixed_frame": "odom",
    "min_height": 0.1,
}


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Write a recording of these lidars, and each only once."""

    @cache
    def written(*lidars: Lidar, seconds: float = 0.5, drive: Drive = Drive(), **options: Any) -> Path:  # noqa: B008
        return write_world(tmp_path_factory.mktemp("world") / "w.mcap", lidars, drive, seconds=seconds, **options)

    return written


def converted(folder: Path, source: Path, *options: str, status: int = 0) -> Made:
    made = conversions.converted(folder / "out.mcap", source, "--jobs", "2", *options)
    assert made.done.status == status, made.done.stderr
    return made


def errors(scans: Sequence[LaserScan], mount: Rigid | None = None) -> Any:
    """How far the returns of scans are from the walls, metres."""
    return np.concatenate([off_the_walls(returns_in_odom(scan, Drive(), mount)) for scan in scans])


def misplaced(scans: Sequence[LaserScan], mount: Rigid | None = None) -> float:
    """The share of returns that are off the walls by more than half the width of their beam, and a millimetre.

    A beam stands for every direction within half its width, so not even exact scans are nearer. The millimetre is for
    float32 and for poses that are interpolated between those of the odometry.
    """
    widths = np.concatenate([scan.ranges[np.isfinite(scan.ranges)] * scan.angle_increment for scan in scans])
    return float(np.mean(errors(scans, mount) > widths / 2 + 0.001))


def joined(*topics: str) -> tuple[str, ...]:
    return tuple(word for topic in topics for word in ("--topic", f"{topic}:=/scan"))


TWO = joined("/front", "/rear")
TURNS = ("--topic", "/front:=/scan", "--every", "0.1", "--accumulate", "0.1")

#: Lidars, seconds, options, the number of scans, and the share of misplaced returns if motion is not corrected.
EXACT: dict[str, tuple[list[Lidar], float, tuple[str, ...], int, float]] = {
    "two lidars": ([FRONT, REAR], 0.5, (*TWO, *FINE), 5, 0.7),
    "packets": ([PACKETS], 0.6, (*TURNS, *FINE), 6, 0.7),
    "three lidars and a scanner": ([FRONT, REAR, TOP, FLAT], 1.0, (*TWO, *joined("/top", "/flat"), *FINE), 10, 0.8),
    "two scanners": ([FLAT, FLAT2], 1.0, ("--rebin", *joined("/flat", "/flat2"), *FINE_BEAMS), 9, 0.8),
}


@pytest.mark.parametrize("name", sampled(EXACT, 1))
def test_every_return_is_on_its_wall(name: str, world: Callable[..., Path], tmp_path: Path) -> None:
    lidars, seconds, options, count, share = EXACT[name]
    source = world(*lidars, seconds=seconds)
    done = converted(tmp_path, source, *options, *MOVED, "--deskew")
    assert len(done.scans) == count
    assert all(scan.frame_id == "base_link" and scan.time_increment == 0 for scan in done.scans)
    assert done.timed == sorted(done.timed, key=lambda timed: timed[0])
    assert (misplaced(done.scans), np.max(errors(done.scans)) < 0.02) == (0, True)
    plain = converted(tmp_path, source, *options, *UNMOVED).scans
    assert misplaced(plain) > share
    counts = {each["topic"]: each["joined"] for each in done.report["topics"] if each["joined"]}
    if name == "two lidars":
        assert [scan.stamp_ns for scan in done.scans] == [BEGIN_NS + number * 100_000_000 for number in range(count)]
        # 1800 directions of each; the first scan has none of the second lidar.
        assert sum(np.isfinite(scan.ranges).sum() for scan in done.scans) > (count - 1) * 2400 + 1200
        assert np.percentile(errors(plain), 95) > 0.1
        rear = done.topic("/rear")
        assert (rear["action"], rear["messages_out"]) == ("joined", 4)
        assert (counts["/rear"]["used"], counts["/rear"]["scans_without"]) == (4, 1)
        assert done.topic("/front")["messages_out"] == 5
    elif name == "packets":
        assert all(np.isfinite(scan.ranges).sum() > 0.6 * len(scan.ranges) for scan in done.scans[1:-1])
        assert all(scan.scan_time == pytest.approx(0.1) for scan in done.scans)
        entry = done.topic("/front")
        assert (entry["messages_in"], counts["/front"]["used"], entry["messages_out"]) == (60, 60, 6)
    elif "/top" in counts:
        top = counts["/top"]
        assert (top["messages"], top["used"], top["unmatched"], counts["/flat"]["used"]) == (19, 10, 9, 9)
        assert "9 of 19 messages of /top are in no scan on /scan" in done.stdout


def test_a_scanner_with_varying_beams_gets_a_constant_number(world: Callable[..., Path], tmp_path: Path) -> None:
    source = world(FLAT, seconds=0.8)
    with closing(open_recording(source)) as reader:
        before = [decode_laserscan(m.data, "cdr") for m in reader.messages() if m.connection.topic == "/flat"]
    assert len({len(scan.ranges) for scan in before}) > 1
    rebin = ("--rebin", "--preset", "slam_toolbox", "--beams", "720", "--scan-time", "auto")
    done = converted(tmp_path, source, *rebin, "--fixed-frame", "odom", "--deskew")
    assert [scan.stamp_ns for scan in done.scans] == [scan.stamp_ns for scan in before]
    assert {(len(scan.ranges), scan.frame_id) for scan in done.scans} == {(720, "flat")}
    assert {scan.scan_time for scan in done.scans} == {np.float32(0.1)}
    assert "/flat: scan_time is 0.1 s, the median interval of its " in done.stdout
    # Half as many beams as were measured: in each, the nearest of two.
    assert misplaced(done.scans, mount=FLAT.mount) == 0
    assert np.mean(errors(done.scans, mount=FLAT.mount) < 0.02) > 0.98
    for scan in done.scans:
        lit = scan.intensities[np.isfinite(scan.ranges)]
        assert set(lit.tolist()) == {10.0, 20.0, 30.0, 40.0}
        assert lit.size > 600
    assert misplaced(converted(tmp_path, source, *rebin).scans, mount=FLAT.mount) > 0.7


@pytest.mark.parametrize("options", sampled([row for (row,) in rows(TABLES, "options for any number of jobs")], 2))
def test_any_number_of_jobs_gives_the_same_bytes(
    options: dict[str, Any], world: Callable[..., Path], tmp_path: Path
) -> None:
    source = world(*(replace(each, columns=360) for each in (FRONT, REAR, FLAT)))
    found = set()
    for jobs in (1, 2, 5):
        pc2scan.convert(source, tmp_path / "out.mcap", jobs=jobs, overwrite=True, **options)
        found.add((tmp_path / "out.mcap").read_bytes())
    assert len(found) == 1


NEAR = (*TWO, *UNMOVED)


@pytest.mark.parametrize(("options", "status", "said"), rows(TABLES, "what is wrong"))
def test_what_is_wrong_is_said(
    options: tuple[str, ...], status: int, said: str, world: Callable[..., Path], tmp_path: Path
) -> None:
    source = world(SMALL_FRONT, SMALL_REAR, SMALL_FLAT)
    assert said in converted(tmp_path, source, *options, status=status).stderr


@pytest.mark.parametrize("options", [row for (row,) in rows(TABLES, "correct options")])
def test_correct_options_draw_no_such_warning(
    options: tuple[str, ...], world: Callable[..., Path], tmp_path: Path
) -> None:
    said = converted(tmp_path, world(SMALL_FRONT, SMALL_REAR, SMALL_FLAT, drive=TILTING), *options)
    for words in ("milliseconds", "no point is moved", "no effect"):
        assert words not in said.stderr
    assert "level by odom" in said.stdout or "--level" not in options


@pytest.mark.parametrize(("clock", "seconds", "status", "said"), rows(TABLES, "clocks that differ"))
def test_clocks_that_differ_are_told(
    clock: float, seconds: float, status: int, said: list[str], world: Callable[..., Path], tmp_path: Path
) -> None:
    source = world(SMALL_FRONT, replace(SMALL_REAR, clock=clock), seconds=seconds)
    told = converted(tmp_path, source, *NEAR, status=status).stderr
    assert all(words in told for words in said)
    assert ("the stamps of" in told) is bool(said)


def test_gaps_of_the_odometry_and_silent_lidars_are_reported(world: Callable[..., Path], tmp_path: Path) -> None:
    done = converted(tmp_path, world(SMALL_FRONT, seconds=0.6, odometry_hz=3), *MOVED, "--accumulate", "0.3")
    assert "transforms to --fixed-frame were missing for up to 0.333 s" in done.stderr
    assert done.topic("/front")["longest_gap_s"] == pytest.approx(1 / 3, abs=1e-6)
    # Every other cloud is at the time of a transform, and is joined with one that is between two.
    done = converted(tmp_path, world(SMALL_FRONT, seconds=0.6, odometry_hz=5), *MOVED, "--accumulate", "2clouds")
    assert done.topic("/front")["longest_gap_s"] == 0.2
    front, rear = world(SMALL_FRONT, seconds=3.0), world(SMALL_REAR, seconds=1.0)
    silent = run("convert", front, rear, "-o", tmp_path / "o.mcap", *TWO, *MOVED, "--min-height", "0.1")
    assert silent.status == 0, silent.stderr
    assert "21 scans on /scan have nothing of /rear" in " ".join(silent.stderr.split())


@pytest.mark.parametrize("name", ["out.mcap", "out.bag", "out"])
def test_the_last_scan_was_logged_with_its_last_message(name: str, world: Callable[..., Path], tmp_path: Path) -> None:
    driven = world(SMALL_FRONT, SMALL_REAR, seconds=0.3)
    other = Item(CHATTER, BEGIN_NS + 60 * SECOND, {2: string("later", 2)})
    later = write_mcap(tmp_path / "later.mcap", Recording((CHATTER,), (other,)))
    with closing(open_recording(driven)) as reader:
        last_ns = max(each.log_time_ns for each in reader.messages() if each.connection.topic in {"/front", "/rear"})
    pc2scan.convert([driven, later], tmp_path / name, **BOTH)
    assert [scan.log_time_ns for scan in pc2scan.scans(tmp_path / name)][-1] == last_ns
