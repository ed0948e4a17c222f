from __future__ import annotations

import math

import numpy as np
import pytest

from pc2scan.errors import UsageError
from pc2scan.tf.options import FrameOptions
from pc2scan.tf.static import StaticTransform


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
        ("base lidar 1 2 3", "5 values"),
        ("base lidar 1 2 x 0 0 0", "'x' is not a number"),
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


def test_units_of_a_static_transform() -> None:
    written = StaticTransform.parse("base lidar 20cm 0.5m -300mm 90deg deg(45) pi/2").parent_from_child
    plain = StaticTransform.of("base", "lidar", [0.2, 0.5, -0.3], [math.pi / 2, math.pi / 4, math.pi / 2])
    assert written.pose == plain.parent_from_child.pose


@pytest.mark.parametrize(
    ("text", "words", "cure"),
    [
        ("b l 0 0 1 0 45 0", "pitch is 45 rad", "`static_tf='b l 0 0 1 0 45deg 0'`, which is 0 0.785398 0 rad"),
        ("b l 0 0 1 0 3 2 0", "length 3.606", "`static_tf='b l 0 0 1 0 0.83205 0.5547 0'`"),
        ("1 2 3 0.1 0.2 0.3 b l 100", "after the numbers", "`static_tf='b l 1 2 3 0.3 0.2 0.1'` (roll pitch yaw)"),
        ("1 2 3 0 0 0 1 b l", "after the numbers", "`static_tf='b l 1 2 3 0 0 0 1'`"),
    ],
)
def test_what_is_asked_about(text: str, words: str, cure: str) -> None:
    with pytest.raises(UsageError, match=words) as caught:
        StaticTransform.parse(text)
    assert caught.value.hint is not None
    assert cure in caught.value.hint


def test_there_must_be_something_to_write() -> None:
    with pytest.raises(UsageError, match="no added transform"):
        FrameOptions(write_static=True)
