"""Points of several messages in one scan: that of all points in one cloud, to the bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pc2scan.core.params import ProjectionParams
from pc2scan.core.plain import transformed
from pc2scan.core.project import Part, Projector, packed
from pc2scan.core.rigid import Rigid

if TYPE_CHECKING:
    from numpy.typing import NDArray

CHOICES = [
    {},
    {"reduce": "max"},
    {"reduce": "mean"},
    {"reduce": "kth", "kth": 2},
    {"min_points": 3},
    {"reduce": "surface"},
    {"geometry": "centered", "range_max": 30.0, "no_return": "zero"},
    {"use_inf": False, "range_max": 20.0},
]


def cloud(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    points = rng.normal(0, 5, (3, count)).astype(np.float32)
    points[:, rng.uniform(size=count) < 0.05] = np.nan
    points[0, rng.uniform(size=count) < 0.02] = np.inf
    return points


@settings(deadline=None, max_examples=150)
@given(
    st.integers(0, 2**32),
    st.lists(st.integers(0, 300), min_size=1, max_size=4),
    st.sampled_from(CHOICES),
    st.booleans(),
)
def test_the_scan_is_that_of_the_concatenated_clouds(
    seed: int, counts: list[int], choice: dict[str, str | float], lit: bool
) -> None:
    rng = np.random.default_rng(seed)
    params = ProjectionParams(min_height=-2.0, max_height=2.0, angle_increment=0.05, **choice)  # type: ignore[arg-type]
    projector = Projector(params)
    clouds = [cloud(rng, count) for count in counts]
    values = [rng.uniform(0, 200, count).astype(np.uint8) for count in counts]
    moves = [Rigid.from_rpy(0.1, -0.2, rng.normal(), (rng.normal(), 1.0, 0.3)) for _ in counts]
    parts = [
        Part(x, y, z, move.as_float32(), value if lit else None)
        for (x, y, z), move, value in zip(clouds, moves, values, strict=True)
    ]
    with np.errstate(all="ignore"):
        placed = [
            transformed(x, y, z, packed(move.as_float32())) for (x, y, z), move in zip(clouds, moves, strict=True)
        ]
        x, y, z = (np.concatenate([each[axis] for each in placed]) for axis in range(3))
    expected = projector(x, y, z, None, np.concatenate(values) if lit else None)
    found = projector.together(parts)
    assert found.ranges.tobytes() == expected.ranges.tobytes()
    assert found.intensities.tobytes() == expected.intensities.tobytes()
    assert found.counts == expected.counts


def test_heights_do_not_count_for_parts_that_have_none() -> None:
    projector = Projector(ProjectionParams())
    x = np.array([1.0, 2.0], np.float32)
    zeros = np.zeros(2, np.float32)
    assert projector.together([Part(x, zeros, zeros)]).counts.height == 2
    found = projector.together([Part(x, zeros, zeros), Part(x, zeros, zeros - 1, any_height=True)])
    assert (found.counts.height, found.counts.used) == (2, 2)
    assert np.nanmin(found.ranges) == pytest.approx(1.0)


def test_parts_without_intensities_count_as_zero() -> None:
    projector = Projector(ProjectionParams(min_height=-1.0))
    one = np.ones(1, np.float32)
    parts = [Part(one, one * 0, one * 0), Part(one * 0, one, one * 0, None, one * 7)]
    found = projector.together(parts)
    assert sorted(found.intensities[np.isfinite(found.ranges)].tolist()) == [0.0, 7.0]
