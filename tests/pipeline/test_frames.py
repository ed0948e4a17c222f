from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.errors import TransformError, UsageError
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import Connection, RawMessage
from pc2scan.pipeline.frames import (
    FrameOptions,
    Frames,
    StaticTransform,
    load_static_transforms,
    read_transforms,
    tf_connections,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TF = "tf2_msgs/TFMessage"


def connection(number: int, topic: str, kind: str = TF) -> Connection:
    return Connection(number, topic, kind, "ros1")


class Recording:
    """The part of a reader that transforms are read through."""

    def __init__(self, *messages: tuple[str, Any]) -> None:
        topics = list(dict.fromkeys(topic for topic, _ in messages))
        self.connections = [connection(i, topic) for i, topic in enumerate(topics)]
        by_topic = {c.topic: c for c in self.connections}
        self._messages = [
            RawMessage(by_topic[topic], i, rows if isinstance(rows, bytes) else encode_transforms(rows, "ros1"), i)
            for i, (topic, rows) in enumerate(messages)
        ]

    def messages(self, connections: list[Connection]) -> Iterator[RawMessage]:
        wanted = {c.id for c in connections}
        return (m for m in self._messages if m.connection.id in wanted)


def row(parent: str, child: str, stamp_ns: int, x: float) -> tuple[Any, ...]:
    return (parent, child, stamp_ns, x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def frames(recordings: list[Any], options: FrameOptions | None = None, **kwargs: Any) -> tuple[Frames, list[str]]:
    options = options or FrameOptions()
    buffer, warnings = read_transforms(recordings, options)
    return Frames(kwargs.get("target", "base"), options.source_frame, buffer, kwargs.get("tolerance_ns", 0)), warnings


def test_both_notations_of_a_static_transform() -> None:
    by_angles = StaticTransform.parse("base lidar 1 2 3 0 0 1.5707963267948966")
    by_quaternion = StaticTransform.parse("base lidar 1 2 3 0 0 0.7071067811865476 0.7071067811865476")
    assert (by_angles.parent, by_angles.child) == ("base", "lidar")
    # Half angles differ in the last bits.
    np.testing.assert_allclose(by_angles.parent_from_child.pose, by_quaternion.parent_from_child.pose, atol=1e-15)
    point = by_angles.parent_from_child.apply(np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(point, [[1.0, 3.0, 3.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base lidar 1 2 3", "5 words"),
        ("base lidar 1 2 x 0 0 0", "could not convert"),
        ("base base 1 2 3 0 0 0", "two frames"),
        ("base /base 1 2 3 0 0 0", "two frames"),
        ("base lidar 0 0 0 0 0 0 0", "zero"),
        ("base lidar nan 0 0 0 0 0", "finite"),
        ("base lidar 0 0 0 inf 0 0", "finite"),
    ],
)
def test_what_is_no_static_transform(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        StaticTransform.parse(text)


def test_a_file_of_static_transforms(tmp_path: Path) -> None:
    path = tmp_path / "mounts.yaml"
    path.write_text(
        """
- base lidar 1 0 0 0 0 0
- {parent: base, child: camera, translation: [0, 1, 0], rpy: [0, 0, 3.141592653589793]}
- frame_id: base
  child_frame_id: imu
  rotation: [0, 0, 0, 2]
"""
    )
    first, second, third = load_static_transforms(path)
    assert first.parent_from_child.translation.tolist() == [1, 0, 0]
    assert second.parent_from_child.rpy == pytest.approx((0, 0, math.pi))
    assert (third.child, third.parent_from_child.quaternion.tolist()) == ("imu", [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "not a YAML list"),
        ("- 5", "entry 1"),
        ("- base lidar 1", "entry 1"),
        ("- {parent: a, child: b, roll: 1}", "unknown key 'roll'"),
        ("- {parent: a, child: b, translation: [1, 2]}", "translation"),
        ("- {parent: a, child: b, rpy: [1, 2, true]}", "rpy"),
        ("- [", "not YAML"),
        ("- !!python/object/apply:os.getcwd []", "YAML"),
    ],
)
def test_files_that_are_no_list_of_transforms(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mounts.yaml"
    path.write_text(text)
    with pytest.raises(UsageError, match=words) as caught:
        load_static_transforms(path)
    assert caught.value.path == path


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        load_static_transforms(tmp_path / "nothing.yaml")


def test_no_target_frame_leaves_everything_in_its_place() -> None:
    assert Frames().place("lidar", 5) == ("lidar", None)


@pytest.mark.parametrize("own", ["base", "/base"])
def test_a_message_that_is_in_the_target_frame_stays(own: str) -> None:
    known, _ = frames([])
    assert known.place(own, 5) == ("base", None)


def test_transforms_of_several_recordings_count_together_whatever_their_order() -> None:
    first = Recording(("/tf", [row("odom", "base", 20, 1.0), row("odom", "base", 10, 0.0)]))
    second = Recording(("/tf_static", [row("base", "lidar", 0, 0.5)]))
    known, warnings = frames([first, second], target="odom")
    place = known.place("lidar", 15)
    assert warnings == []
    assert place.frame_id == "odom"
    assert place.target_from_source is not None
    assert place.target_from_source.translation.tolist() == [1.0, 0, 0]


def test_the_users_transform_beats_the_recordings() -> None:
    recording = Recording(("/tf_static", [row("base", "lidar", 0, 0.5)]))
    added = FrameOptions(static=(StaticTransform.parse("base lidar 7 0 0 0 0 0"),))
    known, _ = frames([recording], added)
    place = known.place("lidar", 15)
    assert place.target_from_source is not None
    assert place.target_from_source.translation.tolist() == [7, 0, 0]


def test_the_source_frame_is_overridden() -> None:
    recording = Recording(("/tf_static", [row("base", "lidar", 0, 0.5)]))
    known, _ = frames([recording], FrameOptions(source_frame="lidar"))
    assert known.place("", 5).target_from_source is not None
    assert Frames(source_frame="lidar").place("wrong", 5) == ("lidar", None)


def test_the_tolerance_takes_the_nearest_transform() -> None:
    recording = Recording(("/tf", [row("base", "lidar", 100, 1.0), row("base", "lidar", 200, 2.0)]))
    strict, _ = frames([recording])
    with pytest.raises(TransformError, match="too early"):
        strict.place("lidar", 95)
    lenient, _ = frames([recording], tolerance_ns=5)
    place = lenient.place("lidar", 95)
    assert place.target_from_source is not None
    assert place.target_from_source.translation.tolist() == [1, 0, 0]
    with pytest.raises(TransformError):
        lenient.place("lidar", 94)


def test_unusable_transforms_become_warnings() -> None:
    bad = [("base", "base", 1, *[0.0] * 6, 1.0), ("base", "lidar", 1, *[0.0] * 7)]
    _, warnings = frames([Recording(("/tf", bad), ("/tf", b"\x01"))])
    told = "\n".join(warnings)
    assert "TF_SELF_TRANSFORM" in told
    assert "quaternion is zero" in told
    assert "cannot be decoded" in told


def test_only_topics_named_tf_count_by_default() -> None:
    chosen = tf_connections(
        [
            connection(1, "/tf"),
            connection(2, "/tf_static"),
            connection(3, "/tf_old"),
            connection(4, "/tf", "std_msgs/String"),
        ]
    )
    assert [c.id for c in chosen] == [1, 2]
    assert [c.id for c in tf_connections([connection(3, "/tf_old"), connection(1, "/tf")], ["tf_old"])] == [3]


def test_both_types_of_tf_count() -> None:
    chosen = tf_connections([connection(1, "/tf", "tf/tfMessage"), connection(2, "/tf", "tf2_msgs/msg/TFMessage")])
    assert [c.id for c in chosen] == [1, 2]


def test_a_single_namespace_is_found_and_several_have_to_be_chosen_from() -> None:
    one = [connection(1, "/robot1/tf"), connection(2, "/robot1/tf_static")]
    assert [c.id for c in tf_connections(one)] == [1, 2]
    two = [*one, connection(3, "/robot2/tf")]
    with pytest.raises(UsageError, match="/robot1, /robot2") as caught:
        tf_connections(two)
    assert "`tf_topics=/robot1/tf`" in (caught.value.hint or "")
    assert [c.id for c in tf_connections(two, ["/robot2/tf"])] == [3]
    # The global ones are meant where there are any.
    assert [c.id for c in tf_connections([*two, connection(4, "/tf")])] == [4]


def test_a_topic_without_transforms_is_an_error_that_lists_those_with() -> None:
    with pytest.raises(UsageError, match="no transforms on /odom") as caught:
        tf_connections([connection(1, "/tf")], ["/odom"])
    assert "/tf" in (caught.value.hint or "")


def test_there_must_be_something_to_write() -> None:
    with pytest.raises(UsageError, match="no added transform"):
        FrameOptions(write_static=True)
