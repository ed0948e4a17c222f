"""Clouds of a robot that turns, deskewed by the real command."""

from __future__ import annotations

import json
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.cli.in_process import run_command
from pc2scan.messages.laserscan import LaserScan, decode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, PointField, encode_pointcloud2
from pc2scan.messages.tfmessage import encode_transforms
from support import ROOT
from support.builders import T0, TF, Item, Recording, Stream, write_mcap
from support.command import run
from support.worlds.moving import Lidar, write_world

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.core.rigid import TransformRow
    from support.command import Finished

HALL = ROOT / "fixtures" / "hall.mcap"


def converted(folder: Path, *options: str) -> tuple[Finished, list[LaserScan], dict[str, Any]]:
    done = run(
        "convert", HALL, "-o", folder / "b.mcap", "--overwrite", "--min-height", "-0.3", "--only-scans",
        "--report", folder / "r.json", *options,
    )  # fmt: skip
    report = json.loads((folder / "r.json").read_text()) if (folder / "r.json").exists() else {}
    scans = []
    if (folder / "b.mcap").exists():
        with closing(open_recording(folder / "b.mcap")) as reader:
            scans = [decode_laserscan(m.data, m.connection.serialization) for m in reader.messages()]
    return done, scans, report


@pytest.mark.parametrize("stamp", ["header", "start", "middle", "end"])
def test_deskewed_scans_say_how_far_the_sensor_moved(tmp_path: Path, stamp: str) -> None:
    done, scans, report = converted(tmp_path, "--deskew", "--fixed-frame", "odom", "--stamp", stamp)
    assert done.status == 3
    (topic,) = (entry for entry in report["topics"] if entry["action"] == "converted")
    assert topic["messages_out"] == len(scans) >= 4
    assert 0.01 < topic["motion"]["median_m"] <= topic["motion"]["largest_m"] < 0.5
    assert 0.1 < topic["motion"]["median_deg"] <= topic["motion"]["largest_deg"] < 30
    assert topic["motion"]["longest_gap_s"] == pytest.approx(0.1)
    assert "transforms to --fixed-frame were missing" not in done.stderr
    points = topic["points"]
    assert points["total"] == sum(count for name, count in points.items() if name != "total")
    assert points["no_time"] == 0
    assert all(scan.time_increment == 0 and scan.frame_id == "lidar" for scan in scans)
    assert "deskewed; within a cloud the sensor moved by up to" in done.stdout


def test_where_nothing_moves_deskewing_changes_nothing_but_the_last_bits(tmp_path: Path) -> None:
    _, plain, report = converted(tmp_path)
    assert [entry["motion"] for entry in report["topics"]] == [None] * len(report["topics"])
    _, same, report = converted(tmp_path, "--deskew", "--fixed-frame", "base_link")
    assert len(plain) == len(same) == 5
    for one, other in zip(plain, same, strict=True):
        both = np.isfinite(one.ranges) & np.isfinite(other.ranges)
        assert both.sum() > 200
        assert np.mean(np.abs(one.ranges[both] - other.ranges[both]) < 1e-5) > 0.99
    (motion,) = (entry["motion"] for entry in report["topics"] if entry["motion"])
    assert motion["largest_m"] < 1e-9


def test_the_turn_of_a_lidar_is_measured(tmp_path: Path) -> None:
    moved = ("--deskew", "--fixed-frame", "odom")
    _, timed, _ = converted(tmp_path, *moved)
    done, scans, report = converted(tmp_path, *moved, "--point-time", "azimuth")
    (note,) = (note for note in report["notes"] if "azimuth" in note)
    assert "one turn takes 0.1 s, clockwise, and the stamp is that of the last point; measured: the period" in note
    assert note in " ".join(done.stdout.split())
    # Of the first cloud only the last point has a transform, where its azimuth gives it the time of the stamp.
    assert len(scans[1:]) == len(timed) == 4
    for one, other in zip(scans[1:], timed, strict=True):
        both = np.isfinite(one.ranges) & np.isfinite(other.ranges)
        assert both.sum() > 200
        assert np.mean(np.abs(one.ranges[both] - other.ranges[both]) < 1e-3) > 0.98
    measured = (tmp_path / "b.mcap").read_bytes()
    converted(tmp_path, *moved, "--point-time", "azimuth:0.1:cw:end")
    assert (tmp_path / "b.mcap").read_bytes() == measured
    converted(tmp_path, *moved, "--point-time", "azimuth:start")
    assert (tmp_path / "b.mcap").read_bytes() != measured


def test_what_a_lidar_turns_like_is_to_be_typed_where_clouds_do_not_tell(tmp_path: Path) -> None:
    world = write_world(tmp_path / "w.mcap", [Lidar()], seconds=1.0)
    words = ("convert", world, "-o", tmp_path / "out.mcap", "--deskew", "--fixed-frame", "odom", "--point-time")
    done = run(*words, "azimuth")
    assert done.status == 2
    assert not (tmp_path / "out.mcap").exists()
    said = " ".join(done.stderr.split())
    assert "/points" in said
    assert "logged 0.1019 s after their stamps, so the stamp may be the time of the first or of the last point" in said
    assert "--point-time azimuth:0.1:ccw:start" in said
    assert run(*words, "azimuth:start").status == 0


# --- Clouds of one lidar on a robot, with times and transforms of all kinds ---

AHEAD = np.linspace(-0.5, 0.5, 40)


def timed_cloud(stamp_ns: int, after_ns: Any, unit: int) -> bytes:
    """Points 2 m away, with absolute times in float64: multiples of ``unit`` nanoseconds since 1970."""
    points = np.zeros(len(after_ns), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<f8")])
    angles = np.resize(AHEAD, len(after_ns))
    points["x"], points["y"], points["t"] = 2 * np.cos(angles), 2 * np.sin(angles), (stamp_ns + after_ns) / unit
    fields = [*(PointField(name, 4 * place, 7) for place, name in enumerate("xyz")), PointField("t", 12, 8)]
    return encode_pointcloud2(
        serialization="cdr", sequence=0, stamp_ns=stamp_ns, frame_id="base_link", fields=fields, point_step=20,
        data=points.tobytes(),
    )  # fmt: skip


def written(path: Path, clouds: dict[int, bytes], tf: list[TransformRow], static: list[TransformRow]) -> Path:
    """A recording of clouds by their stamps, and transforms."""
    rows = [(T0, "/tf_static", encode_transforms(static, "cdr"))] if static else []
    rows += ((row[2], "/tf", encode_transforms([row], "cdr")) for row in tf)
    rows += ((stamp_ns + 200_000_000, "/points", data) for stamp_ns, data in clouds.items())
    kinds = {"/tf_static": TF, "/tf": TF, "/points": POINTCLOUD2}
    streams = {topic: Stream(topic, kind, latched=topic == "/tf_static") for topic, kind in kinds.items()}
    items = tuple(Item(streams[topic], log_time_ns, {2: data}) for log_time_ns, topic, data in sorted(rows))
    return write_mcap(path, Recording(tuple(streams.values()), items))


def ranges_of(source: Path, *options: str) -> tuple[int, Any]:
    """The status, and the ranges of all scans."""
    out = source.parent / "out.mcap"
    files = ("-o", str(out), "--overwrite", "--only-scans", "--min-height", "-1")
    done = run_command(["convert", str(source), *files, *options])
    if not out.exists():
        return done.status, done.messages
    with closing(open_recording(out)) as reader:
        return done.status, np.stack([decode_laserscan(m.data, "cdr").ranges for m in reader.messages()])


def driven(seconds: float, x: float, parent: str = "odom", child: str = "base_link") -> TransformRow:
    return (parent, child, T0 + round(seconds * 1e9), x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


MOVED = ("--deskew", "--fixed-frame", "odom", "--target-frame", "base_link")


@pytest.mark.parametrize("unit", [1, 1_000, 1_000_000, 1_000_000_000])
@pytest.mark.parametrize("after_ns", [np.linspace(0, 400_000, 40), np.array([300_000.0])], ids=["0.4 ms", "one point"])
def test_short_clouds_have_absolute_times(after_ns: Any, unit: int, tmp_path: Path) -> None:
    tf = [driven(number / 10, 0.1 * number) for number in range(-2, 12)]
    clouds = {T0 + k * 100_000_000: timed_cloud(T0 + k * 100_000_000, after_ns, unit) for k in range(8)}
    source = written(tmp_path / "in.mcap", clouds, tf, [])
    status, plain = ranges_of(source)
    assert status == 0
    status, found = ranges_of(source, *MOVED)
    assert status == 0, found
    # At 1 m/s the points have moved by less than half a millimetre.
    assert np.isfinite(found).sum(axis=1).min() >= min(30, len(after_ns))
    both = np.isfinite(found) & np.isfinite(plain)
    np.testing.assert_allclose(found[both], plain[both], rtol=0, atol=5e-4)


def test_a_robot_that_drives_onto_a_cart_stands_still(tmp_path: Path) -> None:
    # It stands in odom up to 0.4 s; from 0.5 s on it stands on a cart, at the same place.
    tf = [driven(number / 10, 0.0) for number in range(-2, 5)]
    tf += [driven(number / 10, -99.0, parent="cart") for number in range(5, 12)]
    after_ns = np.linspace(0, 99_000_000, 400)
    clouds = {T0 + k * 100_000_000 + 7: timed_cloud(T0 + k * 100_000_000 + 7, after_ns, 1000) for k in range(9)}
    source = written(tmp_path / "in.mcap", clouds, tf, [driven(0, 99.0, child="cart")])
    status, found = ranges_of(source, *MOVED)
    assert status == 0, found
    returns = found[np.isfinite(found)]
    assert returns.size > 9 * 30
    np.testing.assert_allclose(returns, 2.0, rtol=0, atol=1e-5)
