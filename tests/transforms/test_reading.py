from __future__ import annotations

import pytest

from pc2scan.errors import UsageError
from pc2scan.transforms.placing import FrameOptions
from pc2scan.transforms.reading import tf_connections
from pc2scan.transforms.static import StaticTransform
from transforms.recorded import TF, connection, frames, made, row


def test_transforms_of_several_recordings_are_merged() -> None:
    first = made(("/tf", [row("odom", "base", 20, 1.0), row("odom", "base", 10, 0.0)]))
    second = made(("/tf_static", [row("base", "lidar", 0, 0.5)]))
    known, warnings = frames([first, second], target="odom")
    place = known.place("lidar", 15)
    assert warnings == []
    assert place.frame_id == "odom"
    assert place.target_from_source is not None
    assert place.target_from_source.translation.tolist() == [1.0, 0, 0]


def test_the_users_transform_beats_the_recordings() -> None:
    recording = made(("/tf_static", [row("base", "lidar", 0, 0.5)]))
    added = FrameOptions(static=(StaticTransform.parse("base lidar 7 0 0 0 0 0"),))
    known, _ = frames([recording], added)
    place = known.place("lidar", 15)
    assert place.target_from_source is not None
    assert place.target_from_source.translation.tolist() == [7, 0, 0]


def test_unusable_transforms_become_warnings() -> None:
    bad = [("base", "base", 1, *[0.0] * 6, 1.0), ("base", "lidar", 1, *[0.0] * 7)]
    _, warnings = frames([made(("/tf", bad), ("/tf", b"\x01"))])
    told = "\n".join(warnings)
    assert "TF_SELF_TRANSFORM" in told
    assert "quaternion is zero" in told
    assert "cannot be decoded" in told


def test_only_topics_named_tf_count_by_default() -> None:
    topics = [
        ("/tf", TF),
        ("/tf_static", "tf/tfMessage"),
        ("/tf_old", TF),
        ("/tf", "std_msgs/String"),
        ("tf_static", TF),
    ]
    connections = [connection(number, *each) for number, each in enumerate(topics)]
    assert [c.id for c in tf_connections(connections)] == [0, 1, 4]
    assert [c.id for c in tf_connections(connections, ["tf_old"])] == [2]
    # Bags of ROS 1 may leave out the leading slash.
    assert [c.is_static for c in connections] == [False, True, False, False, True]
    known, _ = frames([made(("tf_static", [row("base", "lidar", 5, 0.5)]))])
    place = known.place("lidar", 1)
    assert place.target_from_source is not None
    assert place.target_from_source.translation.tolist() == [0.5, 0, 0]


def test_one_namespace_is_found_several_are_a_choice() -> None:
    one = [connection(1, "/robot1/tf"), connection(2, "/robot1/tf_static")]
    assert [c.id for c in tf_connections(one)] == [1, 2]
    two = [*one, connection(3, "/robot2/tf")]
    with pytest.raises(UsageError, match="/robot1, /robot2") as caught:
        tf_connections(two)
    assert "`tf_topics=/robot1/tf`" in (caught.value.hint or "")
    assert [c.id for c in tf_connections(two, ["/robot2/tf"])] == [3]
    # The global ones are meant where there are any.
    assert [c.id for c in tf_connections([*two, connection(4, "/tf")])] == [4]


def test_topics_with_transforms_are_listed() -> None:
    with pytest.raises(UsageError, match="no transforms on /odom") as caught:
        tf_connections([connection(1, "/tf")], ["/odom"])
    assert "/tf" in (caught.value.hint or "")
