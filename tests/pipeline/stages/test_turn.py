"""How a lidar turns whose points have no times, as measured in its first clouds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pc2scan.core.points import Points
from pc2scan.errors import ParameterError
from pc2scan.pipeline.stages.turn import Look, Turn, look, measured_turn

MS = 1_000_000
T0 = 1_700_000_000_000 * MS


def clouds(
    stamps_ms: list[float] | None = None, *, late_ms: float = 4, turns: float = -1.0, parts: int = 1, hidden: int = 0
) -> list[Look]:
    """Return looks at consecutive clouds, each ``1 / parts`` of a turn, without ``hidden`` of 90 directions."""
    stamps = [T0 + round(MS * each) for each in (stamps_ms or range(0, 1100, 100))]
    width = 90 // parts
    seen = (1 << width) - 1 >> hidden
    directions = [seen << number % parts * width for number in range(len(stamps))]
    return [Look(stamp, stamp + round(late_ms * MS), turns, own) for stamp, own in zip(stamps, directions, strict=True)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("azimuth", Turn()),
        ("azimuth:cw", Turn(0, -1)),
        ("azimuth:ccw:end", Turn(0, 1, True)),
        ("azimuth:start", Turn(0, 0, False)),
        ("azimuth:0.1", Turn(0.1)),
        ("azimuth:100ms:end:cw", Turn(0.1, -1, True)),
    ],
)
def test_options_are_parsed(text: str, expected: Turn) -> None:
    assert Turn.parse(text) == expected


def test_period_direction_and_stamp_are_measured() -> None:
    turn, note = measured_turn("/points", Turn(), clouds())
    assert turn == Turn(0.1, -1, True)
    assert note == (
        "/points: the times of points are computed from their azimuth: one turn takes 0.1 s, clockwise, and the stamp "
        "is that of the last point; measured: the period (median interval of the first 11 stamps), the direction "
        "(order of the points of 11 clouds), which point is stamped (clouds are logged 0.004 s after their "
        "stamps, so the last one)"
    )
    assert measured_turn("/points", Turn(), clouds(turns=64.0))[0] == Turn(0.1, 1, True)


def test_what_is_given_is_not_measured() -> None:
    turn, note = measured_turn("/points", Turn(0, 1, False), clouds())
    assert turn == Turn(0.1, 1, False)
    assert note.endswith("measured: the period (median interval of the first 11 stamps)")


def test_a_lidar_does_not_see_through_the_robot() -> None:
    assert measured_turn("/points", Turn(), clouds(hidden=40))[0] == Turn(0.1, -1, True)


def test_a_missing_cloud_and_jitter_change_nothing() -> None:
    turn, _ = measured_turn("/points", Turn(), clouds([0, 100, 200, 401, 500, 600, 696, 800, 900, 1002, 1101]))
    assert turn.period == 0.1


@pytest.mark.parametrize(
    ("found", "why", "typed"),
    [
        (clouds([0, 100, 200]), "3 different stamps in the first 3 clouds, at least 4", "azimuth:0.1"),
        (clouds([5] * 11), "1 different stamps in the first 11 clouds", "azimuth:0.1"),
        (clouds([0, 100, 130, 220, 370, 400, 520]), "are not regular: 0.03 to 0.15 s", "azimuth:0.1"),
        (clouds(list(range(0, 900_000, 70_000))), "come every 70 s", "azimuth:0.1"),
        (
            clouds(list(range(0, 110, 10)), parts=10),
            "in 10% of all directions, several clouds together in 100%",
            "azimuth:0.01",
        ),
        (clouds(parts=2), "in 50% of all directions, several clouds together in 100%", "azimuth:0.1"),
        (clouds(hidden=50), "in 44% of all directions, several clouds together in 44%", "azimuth:0.1"),
        (clouds(turns=-2.0), "go round 2.0 times", "azimuth:0.1"),
        (clouds(turns=0.0), "of 11 clouds, 0 are clockwise, 0 counter-clockwise, 11 neither", "azimuth:0.1:cw"),
        (clouds()[:6] + clouds(turns=1.0)[6:], "6 are clockwise, 5 counter-clockwise", "azimuth:0.1:cw"),
        (clouds(late_ms=0), "the stamps are the log times", "azimuth:0.1:cw:start"),
        (clouds(late_ms=-3), "stamps are up to 0.003 s after the log times", "azimuth:0.1:cw:end"),
        (clouds(late_ms=60), "logged 0.06 s after their stamps", "azimuth:0.1:cw:end"),
        (clouds(late_ms=103), "logged 0.103 s after their stamps", "azimuth:0.1:cw:start"),
    ],
)
def test_insufficient_evidence_is_refused_with_what_to_type(found: list[Look], why: str, typed: str) -> None:
    with pytest.raises(ParameterError) as caught:
        measured_turn("/points", Turn(), found)
    assert "/points" in caught.value.message
    assert why in caught.value.message
    assert f"`point_time={typed}`" in str(caught.value.hint)
    assert caught.value.name == "point_time"
    # What is to be typed can be read.
    words = str(caught.value.hint).split("point_time=")[1].split("`")[0]
    assert Turn.parse(words).period in (0.1, 0.01)


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("layout", ["columns", "rings", "grid"])
def test_turns_and_directions_of_a_cloud(layout: str, clockwise: bool) -> None:
    azimuth = np.linspace(0.3, 0.3 + 2 * math.pi, 600, endpoint=False) * (-1 if clockwise else 1)
    x, y = (np.tile(each, (16, 1)) for each in (5 * np.cos(azimuth), 5 * np.sin(azimuth)))
    if layout == "columns":
        x, y = x.T.ravel(), y.T.ravel()
    elif layout == "rings":
        x, y = x.ravel(), y.ravel()
    x[..., 7] = np.nan
    found = look(Points(0, T0, "lidar", {"x": x.astype(np.float32), "y": y.astype(np.float32), "z": 0 * x}), T0 + 5)
    assert (found.stamp_ns, found.log_time_ns) == (T0, T0 + 5)
    assert found.directions.bit_count() >= 89
    assert found.turns * (-1 if clockwise else 1) == pytest.approx(1 if layout == "columns" else 16, rel=0.01)
    nothing = look(Points(0, T0, "lidar", {"x": np.zeros(3), "y": np.full(3, np.nan), "z": np.zeros(3)}), T0)
    assert (nothing.turns, nothing.directions) == (0.0, 0)
