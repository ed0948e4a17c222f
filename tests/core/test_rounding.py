"""What another rounding of angles explains: every beam that it changes, and hardly one that something else changes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pc2scan import ProjectionParams
from pc2scan.core import fdlibm, plain
from pc2scan.core.project import Projector
from pc2scan.core.rounding import CORRECT, GLIBC, Readings, marks, prove
from pc2scan.core.rule import rule_of

Cloud = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]

PARAMS = {
    "columns": ProjectionParams(angle_increment=2 * math.pi / 1024),
    "sector": ProjectionParams(angle_min=-0.5, angle_max=2.0, angle_increment=0.01),
    "limits": ProjectionParams(angle_increment=2 * math.pi / 1024, range_min=5.0, range_max=20.0, use_inf=False),
    "centered": ProjectionParams(geometry="centered", beams=720),
    "centered sector": ProjectionParams(geometry="centered", angle_min=-1.0, angle_max=1.0, angle_increment=0.02),
}
PARAMS = {name: replace(params, min_height=-1.0, max_height=1.0) for name, params in PARAMS.items()}


def cloud(params: ProjectionParams, seed: int, points: int = 60_000) -> Cloud:
    """Points on the edges of beams, most of them, at all heights."""
    rng = np.random.default_rng(seed)
    layout = params.layout
    edge = rng.integers(-1, layout.count + 2, points) - 0.5 * (params.geometry == "centered")
    angle = layout.angle_min + (edge + np.where(rng.random(points) < 0.2, 0.3, 0.0)) * layout.angle_increment
    reach = rng.uniform(2, 40, points)
    x, y, z = reach * np.cos(angle), reach * np.sin(angle), rng.uniform(-3, 3, points)
    return x.astype(np.float32), y.astype(np.float32), z.astype(np.float32)


def scanned(params: ProjectionParams, points: Cloud, **changes: Any) -> NDArray[np.float32]:
    return Projector(replace(params, **changes))(*points).ranges


def readings(params: ProjectionParams, a: NDArray[np.float32], b: NDArray[np.float32]) -> Readings:
    layout = params.layout
    limits = params.range_min, min(params.range_max, math.inf)
    return Readings(layout.angle_min, layout.angle_max, layout.angle_increment, *limits, a, b, a != b)


def parts(points: Cloud, size: int = 10_000) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    x, y, _ = points
    return [(x[start : start + size], y[start : start + size]) for start in range(0, x.size, size)]


@pytest.mark.parametrize("name", PARAMS)
@pytest.mark.usefixtures("loops")
def test_every_beam_that_the_rounding_changes_is_explained(name: str) -> None:
    params, changed = PARAMS[name], 0
    for seed in range(5):
        points = cloud(params, seed)
        old, new = scanned(params, points, angle_rounding="glibc-2.40"), scanned(params, points)
        for a, b in ((old, new), (new, old)):
            pair = readings(params, a, b)
            differing = int(pair.differing.sum())
            changed += differing
            proof = prove(pair, parts(points))
            assert proof is not None
            one, other = (proof.a_glibc, proof.b_glibc) if a is old else (proof.b_glibc, proof.a_glibc)
            np.testing.assert_array_equal(one, pair.differing)
            assert other.sum() <= differing / 5
            # Each scan fits the points with its own angles, and with them only.
            mine = [GLIBC, CORRECT] if a is old else [CORRECT, GLIBC]
            for side, rounding in enumerate(mine):
                assert proof.returns[side] == np.isfinite(pair.returns()[side]).sum() > 50
                assert proof.fitting[side, rounding] == proof.returns[side]
                assert proof.fitting[side, 1 - rounding] < proof.returns[side]
            # By the scans alone not one of them can be excluded either.
            assert sum(marks(pair)) == differing
    assert changed > 20


def explained_one_by_one(pair: Readings, points: Cloud, params: ProjectionParams) -> NDArray[np.bool_]:
    """The rule of `prove` in loops, with glibc's angles in A and upstream's or the centered geometry as it is."""
    rule, beams = rule_of(params), len(pair.a)
    a, b = ([r if math.isfinite(r) and pair.range_min <= r <= pair.range_max else math.inf for r in side.tolist()]
            for side in (pair.a, pair.b))  # fmt: skip
    x, y, _ = points
    reach = np.sqrt(x.astype(np.float64) ** 2 + y.astype(np.float64) ** 2).astype(np.float32).tolist()
    in_a = plain.bins_of(fdlibm.atan2f(y, x), rule, beams).tolist()
    in_b = plain.bins_of(np.arctan2(y, x, dtype=np.float64).astype(np.float32), rule, beams).tolist()
    found = np.zeros(beams, bool)
    for mine, theirs, one, other in ((a, b, in_a, in_b), (b, a, in_b, in_a)):
        held = {(beam, r) for beam, r in zip(other, reach, strict=True)}
        for beam, to, r in zip(one, other, reach, strict=True):
            if beam == to or beam >= beams or mine[beam] != r or theirs[beam] <= r:
                continue
            lands = to >= beams or theirs[to] <= r
            found[beam] |= lands and (math.isinf(theirs[beam]) or (beam, theirs[beam]) in held)
    return found & pair.differing


@pytest.mark.parametrize("name", PARAMS)
@pytest.mark.usefixtures("loops")
def test_the_rule_is_the_one_that_is_stated(name: str) -> None:
    params = PARAMS[name]
    for seed in range(3):
        points = cloud(params, seed, 5000)
        pair = readings(
            params,
            scanned(params, points, angle_rounding="glibc-2.40"),
            scanned(params, points, min_height=-0.5, angle_rounding="correct"),
        )
        proof = prove(pair, parts(points, 999))
        assert proof is not None
        np.testing.assert_array_equal(proof.a_glibc, explained_one_by_one(pair, points, params))


@pytest.mark.parametrize("name", PARAMS)
def test_what_something_else_changes_is_not_explained(name: str) -> None:
    params = PARAMS[name]
    points = cloud(params, 7)
    new = scanned(params, points)
    turned = replace(params, angle_min=params.angle_min + 0.001, angle_max=params.angle_max + 0.001)
    farther = np.where(np.isfinite(new), new * np.float32(1.0001), new)
    fewer = scanned(params, points, min_height=-0.2)
    for other in (scanned(turned, points), farther, fewer):
        pair = readings(params, new, other)
        proof = prove(pair, parts(points))
        assert proof is not None
        assert pair.differing.sum() > 30
        assert max(proof.a_glibc.sum(), proof.b_glibc.sum()) < 0.2 * pair.differing.sum()
        assert proof.fitting[0, GLIBC] < proof.fitting[0, CORRECT] == proof.returns[0]
    # Both scans fit the points with correct angles: so not even those beams are explained.
    assert proof is not None
    assert proof.fitting[1, GLIBC] < proof.fitting[1, CORRECT] == proof.returns[1]
    pair = readings(params, new, farther)
    assert sum(marks(pair)) < pair.differing.sum()


def test_clouds_of_other_scans_are_noticed() -> None:
    params = PARAMS["columns"]
    new, old = (scanned(params, cloud(params, 1), angle_rounding=way) for way in ("correct", "glibc-2.40"))
    proof = prove(readings(params, new, old), parts(cloud(params, 2)))
    assert proof is not None
    assert (proof.fitting < 0.01 * proof.returns).all()
    assert not proof.a_glibc.any()


def test_what_scans_alone_show() -> None:
    inf = np.float32(np.inf)
    a = np.array([inf, 5, 3, inf, inf, 9, inf, 2, 2, 6, 6, 8], np.float32)
    b = np.array([inf, 3, 5, inf, 7, 9, inf, 2, 1, 6, 6, 7], np.float32)
    #             .    *  *  .    -  .  .    .  -  .  .  end
    params = ProjectionParams()
    assert marks(readings(params, a, b)) == (2, 1)
    # Now the point at 3 m may be in the beam that reads 2 m, but where is that one in the other scan?
    b[1:3] = 2, 4
    assert marks(readings(params, a, b)) == (0, 2)


@pytest.mark.parametrize(
    ("low", "high", "step"),
    [(0.0, 1.0, 0.0), (0.0, 1.0, -0.1), (1.0, 0.0, 0.1), (math.nan, 1.0, 0.1), (0.0, math.inf, 0.1), (0.0, 1.0, 0.3)],
)
def test_beams_of_another_kind_are_not_judged_by_points(low: float, high: float, step: float) -> None:
    a, b = np.ones(10, np.float32), np.full(10, 2, np.float32)
    pair = Readings(low, high, step, 0.0, 10.0, a, b, a != b)
    assert prove(pair, [(a, a)]) is None
    # Whatever a header says, nothing overflows: warnings are errors here.
    large = Readings(-3e38, 3e38, 6.7e37, 0.0, 10.0, a, b, a != b)
    prove(large, [(a, a)])
