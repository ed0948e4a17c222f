"""Times of points that are probably wrong draw a warning."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.advice.measurements import ask_times, time_warnings
from pc2scan.advice.survey import Span, TopicFacts
from pc2scan.bags.observers import observe
from pc2scan.messages.pointcloud2 import POINTCLOUD2, PointField
from pc2scan.model import Connection, Definition
from pc2scan.request.point_time import PointTime
from support.encoded import encode_pointcloud2
from support.memory_reader import MemoryReader

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

T0 = 1_700_000_000_000_000_000
POINTS = Connection(0, "/points", POINTCLOUD2, "cdr", Definition("ros2msg", b""))
CODES = {"<f4": 7, "<f8": 8, "<u4": 6}
SECONDS = np.arange(4000) / 40_000
AZIMUTH = SECONDS * 20 * np.pi
#: A pattern that does not come back.
ROSETTE = 1.2 * np.sin(17.3 * AZIMUTH) * np.cos(3.1 * AZIMUTH)


def option_warnings(
    seconds: Floats = SECONDS,
    azimuth: Floats = AZIMUTH,
    stored: Callable[[Floats], Floats] = lambda seconds: seconds,
    kind: str = "<f8",
    asked: str = "t",
    period_ns: int = 100_000_000,
) -> list[str]:
    rows = []
    for number in range(6):
        points = np.zeros(seconds.size, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", kind)])
        stamp_ns = T0 + number * period_ns
        points["x"], points["y"], points["t"] = np.cos(azimuth), np.sin(azimuth), stored(seconds)
        if kind == "<f8" and stored(seconds)[0] > 1e9:
            points["t"] += number * period_ns / 1e9
        fields = [PointField(name, 4 * place, 7) for place, name in enumerate("xyz")]
        data = encode_pointcloud2(
            serialization="cdr", sequence=0, stamp_ns=stamp_ns, frame_id="lidar", point_step=points.itemsize,
            fields=[*fields, PointField("t", 12, CODES[kind])], data=points.tobytes(),
        )  # fmt: skip
        rows.append((0, stamp_ns, data))
    reader = MemoryReader(Path("made"), [POINTS], rows)
    facts, point_time = TopicFacts([POINTS], Span(None, None, T0)), PointTime.parse(asked)
    ask_times(facts, point_time)
    observe((reader, facts.observers))
    return list(time_warnings(facts, point_time))


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"stored": lambda seconds: np.round(seconds * 1e9), "kind": "<u4"},
        {"stored": lambda seconds: seconds * 1e3, "kind": "<f4"},
        {"stored": lambda seconds: np.round(seconds * 1e6), "kind": "<u4", "asked": "t:us"},
        # Stamped at the end; delayed by the driver; a message in ten; packets.
        {"stored": lambda seconds: seconds - 0.1},
        {"period_ns": 1_000_000_000},
        {"seconds": SECONDS / 100, "azimuth": AZIMUTH / 100, "period_ns": 1_000_000},
        # Points in any order, but with their own times; points in the order of their times, but in any direction.
        {"seconds": (order := np.random.default_rng(1).permutation(SECONDS)), "azimuth": order * 20 * np.pi},
        {"azimuth": ROSETTE},
        {"seconds": np.tile(SECONDS[::4], 4), "azimuth": np.tile(AZIMUTH[::4], 4)},
    ],
)
def test_times_that_are_right_draw_none(case: dict[str, Any]) -> None:
    assert option_warnings(**case) == []


@pytest.mark.parametrize(
    ("case", "what"),
    [
        (
            {"stored": lambda seconds: np.round(seconds * 1e6), "kind": "<u4"},
            "are taken for ns: a cloud takes 0.0001 s, but clouds come every 0.1 s; `point_time=t:us`, if they are us",
        ),
        (
            {"seconds": SECONDS / 75, "stored": lambda seconds: seconds * 1e3, "period_ns": 1_333_333},
            "are taken for s: a cloud takes 1.33 s, but clouds come every 0.00133 s; `point_time=t:ms`",
        ),
        (
            {"stored": lambda seconds: np.round(seconds * 1e5), "kind": "<u4"},
            "are taken for ns: a cloud takes 1e-05 s, but clouds come every 0.1 s; `point_time=FIELD` names another",
        ),
        (
            {"stored": lambda seconds: seconds + T0 / 1e9 + 0.3},
            "measured 0.3 to 0.4 s after the stamp of their cloud, by field t, but clouds come every 0.1 s",
        ),
        ({"stored": lambda seconds: seconds + T0 / 1e9 - 5}, "measured 4.9 to 5 s before the stamp of their cloud"),
    ],
)
def test_times_that_are_probably_wrong_draw_a_warning(case: dict[str, Any], what: str) -> None:
    (text,) = option_warnings(**case)
    assert text.startswith("/points: the ")
    assert what in text
