"""Which points the beams of a scan read."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pc2scan.core.params import CHOICES, ProjectionParams
from pc2scan.core.plain import transformed
from pc2scan.core.project import Part, Projector, packed
from pc2scan.core.rigid import Rigid

pytestmark = pytest.mark.usefixtures("loops")

#: Few values, so that points share beams and ranges.
COORDINATES = st.sampled_from([0.0, -0.0, 0.1, 0.5, 1.0, 1.02, 1.5, -1.0, -1.01, 2.0, 3.0, math.nan, 100.0])
POINTS = arrays.arrays(np.float32, st.tuples(st.integers(0, 40), st.just(3)), elements=COORDINATES.map(np.float32))
PARAMS = st.builds(
    ProjectionParams,
    min_height=st.sampled_from([-10.0, -0.5]),
    max_height=st.just(10.0),
    range_max=st.sampled_from([2.5, math.inf]),
    use_inf=st.booleans(),
    angle_increment=st.sampled_from([0.3, math.pi / 180, 2.0]),
    geometry=st.sampled_from(CHOICES["geometry"]),
    no_return=st.sampled_from(["", "nan", "inf"]),
    min_points=st.integers(1, 3),
    reduce=st.sampled_from(sorted(set(CHOICES["reduce"]) - {"kth"})),
)
KTH = st.builds(
    ProjectionParams,
    min_height=st.just(-10.0),
    reduce=st.just("kth"),
    kth=st.integers(1, 3),
    min_points=st.integers(1, 4),
    angle_increment=st.sampled_from([0.3, 2.0]),
)
MOUNT = Rigid.from_rpy(0.1, -0.2, 0.4, (0.3, 0.0, 0.5)).as_float32()


@given(POINTS, st.one_of(PARAMS, KTH), st.booleans(), st.booleans())
def test_the_points_that_beams_read_give_the_same_scan(
    points: Any, params: ProjectionParams, moved: bool, lit: bool
) -> None:
    project = Projector(params)
    transform = MOUNT if moved else None
    values = np.arange(len(points), dtype=np.float32) if lit else None

    def projected(some: Any) -> Any:
        x, y, z = points[some].T
        return project(x, y, z, transform, None if values is None else values[some])

    def read_of(some: Any) -> Any:
        x, y, z = points[some].T
        return project.read(x, y, z, transform)

    scan = projected(slice(None))
    numbers, beams = read_of(slice(None))
    assert (np.diff(numbers) > 0).all()
    again = projected(numbers)
    assert again.ranges.tobytes() == scan.ranges.tobytes()
    assert again.intensities.tobytes() == scan.intensities.tobytes()
    assert set(beams.tolist()) == set(read_of(numbers)[1].tolist())
    # All are in the beam that they are said to be in, and no beam without a return has one.
    for number, beam in zip(numbers.tolist(), beams.tolist(), strict=True):
        if params.min_points == 1 and params.kth <= 1:
            assert np.isfinite(projected([number]).ranges[beam])
    unread = np.ones(len(scan.ranges), bool)
    unread[beams] = False
    assert np.full(unread.sum(), params.empty_range, np.float32).tobytes() == scan.ranges[unread].tobytes()


@given(st.lists(st.tuples(POINTS, st.booleans()), min_size=1, max_size=4), st.one_of(PARAMS, KTH))
def test_points_of_several_messages_are_read_as_those_of_one(
    clouds: list[tuple[Any, bool]], params: ProjectionParams
) -> None:
    project = Projector(params)
    parts, placed, begins = [], [], [0]
    for points, moved in clouds:
        x, y, z = points.T
        parts.append(Part(x, y, z, MOUNT if moved else None))
        placed.append(np.stack(transformed(x, y, z, packed(MOUNT)) if moved else (x, y, z)))
        begins.append(begins[-1] + len(points))
    x, y, z = np.concatenate(placed, axis=1)
    numbers, beams = project.read(x, y, z)
    found = project.read_together(parts)
    together = [number + begin for (own, _), begin in zip(found, begins, strict=False) for number in own]
    assert together == numbers.tolist()
    assert [beam for _, own in found for beam in own] == beams.tolist()


def read(points: Any, **params: Any) -> tuple[list[int], list[int]]:
    project = Projector(ProjectionParams(min_height=-1.0, max_height=5.0, angle_increment=math.pi / 2, **params))
    numbers, beams = project.read(*np.array(points, np.float32).T)
    return numbers.tolist(), beams.tolist()


#: Four returns of beam 2, one of beam 3, one too high, one NaN.
CLOUD = [(2, 1, 0), (1, 1, 0), (1, 1, 0), (9, 9, 9), (3, 1, 0), (-1, 1, 0), (math.nan, 0, 0)]


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ({}, ([1, 5], [2, 3])),
        ({"reduce": "max"}, ([4, 5], [2, 3])),
        ({"reduce": "mean"}, ([0, 1, 2, 4, 5], [2, 2, 2, 2, 3])),
        ({"reduce": "median"}, ([0, 1, 2, 4, 5], [2, 2, 2, 2, 3])),
        ({"reduce": "kth", "kth": 3}, ([0, 1, 2], [2, 2, 2])),
        ({"reduce": "surface", "surface_slope": 0.0}, ([1, 2, 5], [2, 2, 3])),
        ({"min_points": 2}, ([0, 1, 2, 4], [2, 2, 2, 2])),
        ({"min_points": 5}, ([], [])),
    ],
)
def test_which_points_these_are(params: dict[str, Any], expected: Any) -> None:
    assert read(CLOUD, **params) == expected
