from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pc2scan.errors import UsageError
from pc2scan.tf.static import load_static_transforms

if TYPE_CHECKING:
    from pathlib import Path


def test_a_file_of_static_transforms(tmp_path: Path) -> None:
    path = tmp_path / "mounts.yaml"
    path.write_text(
        """
- base lidar 1 0 0 0 0 0
- {parent: base, child: camera, translation: [0, 100cm, 0], rpy: [0, 0, 180deg]}
- frame_id: base
  child_frame_id: imu
  rotation: [0, 0, 0, 1]
"""
    )
    first, second, third = load_static_transforms(path)
    assert first.parent_from_child.translation.tolist() == [1, 0, 0]
    assert second.parent_from_child.translation.tolist() == [0, 1, 0]
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
        ("- {parent: a, child: b, rpy: [0, 0, 90]}", "yaw is 90 rad"),
        ("- {parent: a, child: b, rpy: [0, 0, 90m]}", "rpy"),
        ("- {parent: a, child: b, rotation: [0, 0, 0, 2]}", "length 2, it must be 1"),
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
    with pytest.raises(UsageError, match="does not exist"):
        load_static_transforms(tmp_path / "nothing.yaml")
