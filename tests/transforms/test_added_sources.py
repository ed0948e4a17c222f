"""Poses of topics and files, and robots' models, as transforms: the same scans as with the same transforms on /tf."""

from __future__ import annotations

import warnings
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.core.rigid import Rigid
from pc2scan.errors import Pc2ScanError, UsageError, stamp_text
from support import sampled
from support.builders import STRING, Item, Stream, item, string, write_mcap, write_rosbag1
from support.tables import rows
from support.worlds.posed import KINDS, SAMPLES, pose_at, recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from support.builders import Recording

TABLES = Path(__file__).with_name("added_sources.txt")

HEIGHTS: dict[str, Any] = {"min_height": -20.0, "max_height": 20.0}
WRITERS: dict[str, Any] = {"mcap": write_mcap, "bag": write_rosbag1}


def scans_of(path: Path, **options: Any) -> list[tuple[int, str, bytes]]:
    """The scans of a recording's clouds in odom."""
    return read(pc2scan.scans(path, "/points", **({"target_frame": "odom"} | HEIGHTS | options)))


def read(stream: pc2scan.Scans) -> list[tuple[int, str, bytes]]:
    """Stamps, frames and ranges; a scan in odom is not what SLAM wants, which is a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pc2scan.RecordingWarning)
        return [(scan.stamp_ns, scan.frame, scan.ranges.tobytes()) for scan in stream]


def rigid(pose: Sequence[float]) -> Rigid:
    return Rigid(np.array(pose[3:]), np.array(pose[:3]))


def is_pose(tree: pc2scan.FrameTree, stamp_ns: int) -> bool:
    """Whether the robot is where it drives. At the stamp of a sample, too, tf2 interpolates."""
    return np.allclose(tree.lookup("odom", "base_link", stamp_ns).pose, pose_at(stamp_ns), rtol=0, atol=1e-12)


def written(folder: Path, made: Recording, name: str = "a", suffix: str = "mcap") -> Path:
    path: Path = WRITERS[suffix](folder / f"{name}.{suffix}", made)
    return path


@pytest.fixture
def by_tf(tmp_path: Path) -> list[tuple[int, str, bytes]]:
    found = scans_of(written(tmp_path, recording("tf"), "tf"))
    assert len({ranges for _, _, ranges in found}) == 5
    return found


@pytest.mark.parametrize(("kind", "suffix"), sampled(product([kind for kind in KINDS if kind != "tf"], WRITERS), 6))
def test_poses_of_a_topic_are_transforms_to_the_bit(
    kind: str, suffix: str, tmp_path: Path, by_tf: list[tuple[int, str, bytes]]
) -> None:
    path = written(tmp_path, recording(kind), kind, suffix)
    frame = ":base_link" if kind in ("pose", "covariance") else ""
    assert scans_of(path, odom_topic=f"/{kind}{frame}") == by_tf
    # Typed frames replace those of the messages.
    other = written(tmp_path, recording(kind, frames=("world", "robot")), "other", suffix)
    assert scans_of(other, odom_topic=f"/{kind}:odom:base_link") == by_tf


@pytest.mark.parametrize("suffix", WRITERS)
def test_the_output_has_the_transforms_that_were_used(suffix: str, tmp_path: Path) -> None:
    source = written(tmp_path, recording("odometry"), "odometry", suffix)
    out = tmp_path / f"out.{suffix}"
    report = pc2scan.convert(source, out, target_frame="base_link", odom_topic="/odometry", **HEIGHTS)
    (entry,) = (topic for topic in report.topics if topic.action == "added")
    assert (entry.topic, entry.target, entry.messages_in, entry.messages_out) == ("/odometry", "/tf", 16, 16)
    frames = pc2scan.tf(out)
    expected = pc2scan.tf(written(tmp_path, recording("tf"), "tf", suffix))
    assert not frames.warnings
    for stamp_ns in (*SAMPLES, SAMPLES[2] + 7):
        assert frames.lookup("odom", "lidar", stamp_ns).pose == expected.lookup("odom", "lidar", stamp_ns).pose


def test_a_needed_frame_that_no_transform_has_is_found(tmp_path: Path, by_tf: list[tuple[int, str, bytes]]) -> None:
    path = written(tmp_path, recording("odometry"), "odometry")
    stream = pc2scan.scans(path, target_frame="odom", **HEIGHTS)
    assert read(stream) == by_tf
    assert any("the poses of /odometry are used (base_link in odom)" in note for note in stream.notes)
    # Nothing is taken that was not needed: wrong odometry beside good transforms changes nothing.
    both = written(tmp_path, recording("tf", "odometry", pose=pose_at), "both")
    assert scans_of(both) == by_tf
    report = pc2scan.convert(both, tmp_path / "out.mcap", target_frame="odom", **HEIGHTS)
    assert not [topic for topic in report.topics if topic.action == "added"]


def test_poses_of_a_topic_replace_other_transforms(tmp_path: Path, by_tf: list[tuple[int, str, bytes]]) -> None:
    """Wheels on /tf, laser odometry as a topic: the named topic is used, and written instead."""
    wheels = recording("tf", pose=lambda _: (0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0))
    laser = recording("odometry")
    odometry = [each for each in laser.items if each.stream.topic == "/odometry"]
    extra = [each for each in wheels.items if each.stream.topic == "/tf"]
    path = written(tmp_path, recording(extra=[*extra, *odometry]))
    assert scans_of(path) != by_tf
    assert scans_of(path, odom_topic="/odometry") == by_tf
    out = tmp_path / "out.mcap"
    named: dict[str, Any] = {"odom_topic": "/odometry", "drop": ["/odometry"]}
    report = pc2scan.convert(path, out, target_frame="odom", **named, **HEIGHTS)
    assert [topic.action for topic in report.topics if topic.topic == "/odometry"] == ["added"]
    assert "/odometry replaces the transforms of base_link in odom" in report.notes
    assert is_pose(pc2scan.tf(out), SAMPLES[3])
    assert pc2scan.tf(out).frames[0].transforms == len(SAMPLES)


def test_odometry_of_a_mounted_lidar_moves_the_robot(tmp_path: Path) -> None:
    mount = rigid((0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0))

    def of_lidar(stamp_ns: int) -> Sequence[float]:
        pose = pose_at(stamp_ns)
        return rigid(pose).compose(mount).pose

    path = written(tmp_path, recording("odometry", frames=("odom", "lidar"), pose=of_lidar))
    tree = pc2scan.tf(path, odom_topic="/odometry")
    assert tree.warnings == ("lidar, which has the poses of /odometry, is fixed to base_link: they become its poses",)
    for stamp_ns in SAMPLES:
        assert np.allclose(tree.lookup("odom", "base_link", stamp_ns).pose, pose_at(stamp_ns), rtol=0, atol=1e-12)


# --- Trajectories ---


def _tum(path: Path, text: str = "{stamp} {pose}\n") -> Path:
    lines = [text.format(stamp=stamp_text(each), pose=" ".join(map(repr, pose_at(each)))) for each in SAMPLES]
    path.write_text("# stamp x y z qx qy qz qw\n" + "".join(lines), encoding="utf-8")
    return path


FRAMES: dict[str, Any] = {"trajectory_frames": "odom:base_link"}


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_trajectory_is_transforms(suffix: str, tmp_path: Path, by_tf: list[tuple[int, str, bytes]]) -> None:
    path = written(tmp_path, recording(), suffix=suffix)
    tum: dict[str, Any] = {"trajectory": _tum(tmp_path / "poses.tum")}
    assert scans_of(path, **tum, **FRAMES) == by_tf
    out = tmp_path / f"out.{suffix}"
    report = pc2scan.convert(path, out, target_frame="base_link", **tum, **FRAMES, **HEIGHTS)
    (entry,) = (topic for topic in report.topics if topic.action == "added")
    # From the last pose before the recording to the first one after it.
    assert entry.target == "/tf"
    assert entry.messages_out == 14
    assert is_pose(pc2scan.tf(out), SAMPLES[5])


@pytest.mark.parametrize(("content", "said"), rows(TABLES, "wrong files"))
def test_a_wrong_trajectory_is_refused_with_its_line(content: str, said: str, tmp_path: Path) -> None:
    path = written(tmp_path, recording())
    (tmp_path / "p.txt").write_text(content, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        pc2scan.tf(path, trajectory=tmp_path / "p.txt", **FRAMES)
    assert said in f"{caught.value} {caught.value.hint}"
    assert "p.txt" in str(caught.value)


# --- The robot's model ---

MODEL = """<?xml version="1.0"?>
<robot name="r">
  <link name="base_link"/><link name="lidar"/>
  <joint name="mount" type="fixed">
    <parent link="base_link"/><child link="lidar"/>
    <origin xyz="0 0 0.5" rpy="0 0 0"/>
  </joint>
  <joint name="wheel_joint" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
</robot>
"""


def described(text: str) -> Item:
    stream = Stream("/robot_description", STRING, latched=True)
    return item(stream, SAMPLES[0] - 7, lambda version, _: string(text, version))


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_models_fixed_joints_are_static_transforms(
    suffix: str, tmp_path: Path, by_tf: list[tuple[int, str, bytes]]
) -> None:
    (tmp_path / "robot.urdf").write_text(MODEL, encoding="utf-8")
    bare = written(tmp_path, recording("tf", mounted=False), "bare", suffix)
    with pytest.raises(Pc2ScanError, match="no transform has the source frame 'lidar'"):
        scans_of(bare)
    assert scans_of(bare, urdf=tmp_path / "robot.urdf") == by_tf
    known = written(tmp_path, recording("tf", mounted=False, extra=[described(MODEL)]), "known", suffix)
    stream = pc2scan.scans(known, target_frame="odom", **HEIGHTS)
    assert read(stream) == by_tf
    assert any("1 fixed joint of /robot_description is used: lidar in base_link" in note for note in stream.notes)
    # The recording's own transforms win.
    other = MODEL.replace("0 0 0.5", "3 4 5")
    assert scans_of(written(tmp_path, recording("tf", extra=[described(other)]), "own", suffix)) == by_tf
    # The file wins over the topic.
    both = written(tmp_path, recording("tf", mounted=False, extra=[described(other)]), "both", suffix)
    assert scans_of(both, urdf=tmp_path / "robot.urdf") == by_tf
    out = tmp_path / f"out.{suffix}"
    pc2scan.convert(known, out, target_frame="base_link", write_static_tf=True, **HEIGHTS)
    assert pc2scan.tf(out).lookup("base_link", "lidar").translation.tolist() == [0, 0, 0.5]


@pytest.mark.parametrize(("content", "said"), rows(TABLES, "wrong models"), ids=lambda text: text[:60])
def test_a_wrong_model_is_refused_in_a_file_and_passed_over_in_a_recording(
    content: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "r.urdf").write_text(content, encoding="utf-8")
    path = written(tmp_path, recording("tf", extra=[described(content)]))
    with pytest.raises(UsageError) as caught:
        pc2scan.tf(path, urdf=tmp_path / "r.urdf")
    assert said in f"{caught.value} {caught.value.hint}"
    assert any(
        text.startswith("/robot_description: the robot's model cannot be used") for text in pc2scan.tf(path).warnings
    )


# --- Hostile messages ---


@pytest.mark.parametrize(("options", "said"), rows(TABLES, "wrong options"))
def test_wrong_options_say_what_to_type(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = written(tmp_path, recording("odometry", "pose"))
    with pytest.raises(Pc2ScanError) as caught:
        pc2scan.tf(path, **options)
    assert said in f"{caught.value} {caught.value.hint}"
