from __future__ import annotations

import numpy as np
import pytest

from pc2scan.errors import UsageError
from pc2scan.tf.options import FrameOptions, StaticTransform


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


def test_there_must_be_something_to_write() -> None:
    with pytest.raises(UsageError, match="no added transform"):
        FrameOptions(write_static=True)
