"""Rigid transforms against a scalar reference, rotation matrices and the algebra of the group."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from core.reference import reference_rotation
from pc2scan.core.rigid import Rigid, interpolate_poses, slerp

if TYPE_CHECKING:
    from numpy.typing import NDArray

Quaternion = tuple[float, float, float, float]

component = st.floats(-1, 1)
coordinate = st.floats(-1e3, 1e3)
ratio = st.floats(0, 1)


@st.composite
def quaternions(draw: st.DrawFn) -> Quaternion:
    x, y, z, w = (draw(component) for _ in range(4))
    norm = math.hypot(x, y, z, w)
    assume(norm > 1e-3)
    return (x / norm, y / norm, z / norm, w / norm)


@st.composite
def rigids(draw: st.DrawFn) -> Rigid:
    return Rigid(np.array(draw(quaternions())), np.array([draw(coordinate) for _ in range(3)]))


def rotation_about(axis: str, angle: float) -> NDArray[np.float64]:
    c, s = math.cos(angle), math.sin(angle)
    return np.array(
        {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
    )


def reference_slerp(first: Quaternion, last: Quaternion, t: float) -> Quaternion:
    """tf2's slerp as its header writes it, one number at a time."""
    dot = sum(a * b for a, b in zip(first, last, strict=True))
    norm = math.sqrt(sum(a * a for a in first) * sum(b * b for b in last))
    # tf2 clamps acos, takes twice the angle on the shortest path, and halves it again.
    theta = math.acos(max(-1.0, min(1.0, (-dot if dot < 0 else dot) / norm)))
    if theta == 0:
        return first
    s0, s1 = math.sin((1 - t) * theta), math.sin(t * theta)
    if dot < 0:
        s1 = -s1
    d = 1 / math.sin(theta)
    x, y, z, w = ((a * s0 + b * s1) * d for a, b in zip(first, last, strict=True))
    return (x, y, z, w)


def matrix_of(rigid: Rigid) -> NDArray[np.float64]:
    """(4, 4): by the sandwich product of quaternions."""
    x, y, z, w = rigid.quaternion.tolist()
    left = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    right = np.array([[w, -z, y, -x], [z, w, -x, -y], [-y, x, w, -z], [x, y, z, w]])
    whole: NDArray[np.float64] = left @ right
    whole[:3, 3] = rigid.translation
    return whole


@given(rigids(), rigids(), st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=5))
def test_transforms_are_products_of_matrices(a: Rigid, b: Rigid, points: list[tuple[float, float, float]]) -> None:
    np.testing.assert_allclose(a.matrix, matrix_of(a)[:3, :3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(matrix_of(a.compose(b)), matrix_of(a) @ matrix_of(b), rtol=0, atol=1e-9)
    np.testing.assert_allclose(matrix_of(a.product(b)), matrix_of(a) @ matrix_of(b), rtol=0, atol=1e-9)
    np.testing.assert_allclose(matrix_of(a.inverse()), np.linalg.inv(matrix_of(a)), rtol=0, atol=1e-9)
    some = np.array(points, dtype=np.float64).reshape(-1, 3)
    expected = (matrix_of(a) @ np.column_stack([some, np.ones(len(some))]).T)[:3].T
    np.testing.assert_allclose(a.apply(some), expected, rtol=0, atol=1e-9)


@example(0.3, math.pi / 2, 0.2)
@given(*[st.floats(-7, 7)] * 3)
def test_rpy_turns_about_fixed_axes_roll_first(roll: float, pitch: float, yaw: float) -> None:
    expected = rotation_about("z", yaw) @ rotation_about("y", pitch) @ rotation_about("x", roll)
    rigid = Rigid.from_rpy(roll, pitch, yaw, (1, 2, 3))
    np.testing.assert_allclose(rigid.matrix, expected, rtol=0, atol=1e-12)
    assert rigid.translation.tolist() == [1, 2, 3]
    # The entries are exact to some 1e-16, and the angles to that divided by the cosine of the pitch. Where this is less
    # than sqrt(2e-12), roll is 0 by definition, which is off by as much.
    locked = abs(rigid.matrix[2, 0]) > 1 - 1e-12
    np.testing.assert_allclose(Rigid.from_rpy(*rigid.rpy).matrix, expected, rtol=0, atol=1.5e-6 if locked else 1e-9)


@st.composite
def ends(draw: st.DrawFn) -> tuple[Quaternion, Quaternion]:
    """Two quaternions, or nearly the same one twice, where tf2 takes another branch; of any signs."""
    first, last = draw(quaternions()), draw(quaternions())
    if draw(st.booleans()):
        x, y, z, w = (value + draw(st.floats(-3e-8, 3e-8)) for value in first)
        last = (x, y, z, w)
    x, y, z, w = (draw(st.sampled_from([1, -1])) * value for value in last)
    return first, (x, y, z, w)


@given(ends(), ratio)
def test_slerp_is_tf2s(both: tuple[Quaternion, Quaternion], t: float) -> None:
    first, last = both
    expected = reference_slerp(first, last, t)
    np.testing.assert_allclose(slerp(first, last, t), expected, rtol=0, atol=1e-12)
    posed = interpolate_poses((0.0, 2.0, 4.0, *first), (4.0, 2.0, 0.0, *last), t)
    np.testing.assert_allclose(posed[:3], (4 * t, 2, 4 - 4 * t), rtol=0, atol=1e-12)
    np.testing.assert_allclose(posed[3:], expected, rtol=0, atol=1e-12)
    path = slerp(first, last, np.linspace(0, 1, 5))
    for row, part in zip(path, np.linspace(0, 1, 5).tolist(), strict=True):
        np.testing.assert_allclose(row, reference_slerp(first, last, part), rtol=0, atol=1e-12)


@given(quaternions())
def test_the_float32_matrix_is_eigens(quaternion: Quaternion) -> None:
    *rotation, translation = Rigid(np.array(quaternion), np.array([1e-50, 0.1, 1e39])).as_float32()
    np.testing.assert_array_equal(rotation, reference_rotation(quaternion))
    assert translation.dtype == np.float32
    assert translation.tolist() == [0, np.float32(0.1), math.inf]


def test_quaternions_stay_as_they_are_where_tf2_takes_them() -> None:
    for nearly in ((0.6, 0.8 + 2e-16, 0.0, 0.0), (0.0, 0.0, 0.7071, 0.7071), (0.0, 0.0, 0.0, -1.004)):
        assert Rigid(np.array(nearly), np.zeros(3)).quaternion.tolist() == list(nearly)
    for scale in (3.0, 1e-200, 1e200, 5e-320, 0.72):
        quaternion = Rigid(np.array([0, 0, scale, scale]), np.zeros(3)).quaternion
        np.testing.assert_allclose(quaternion, [0, 0, math.sqrt(0.5), math.sqrt(0.5)], rtol=1e-3)
        assert np.linalg.norm(quaternion) == pytest.approx(1, abs=1e-15)


def test_a_product_rotates_and_does_not_scale() -> None:
    # As people type a quarter turn: 0.7 too short by 1 %.
    typed = Rigid(np.array([0.0, 0.0, 0.7, 0.71]), np.array([1.0, 2.0, 3.0]))
    moved = Rigid.from_rpy(0.1, 0.2, 0.3, (10.0, 0.0, 0.0))
    point = np.array([[4.0, -5.0, 6.0]])
    expected = typed.matrix @ (moved.matrix @ point[0] + moved.translation) + typed.translation
    product = typed.product(moved)
    np.testing.assert_allclose(product.apply(point)[0], expected, atol=1e-12)
    assert np.linalg.norm(product.quaternion) == pytest.approx(1, abs=1e-15)
    assert np.linalg.norm(typed.compose(moved).apply(point)[0] - expected) > 0.01
