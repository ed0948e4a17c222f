"""Scans of several messages whose stamps jump, and of topics that begin late or stop: by the public functions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

import pc2scan
from pc2scan.conversion.combine import grouping
from pc2scan.errors import stamp_text
from support import sampled
from support.builders import CLOUD, SECOND, TF, Item, Recording, Stream, cloud, transforms, write_mcap
from support.tables import rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

TABLES = Path(__file__).with_name("silence.txt")
T0 = 1_700_000_000 * SECOND
HOUR = 3600 * SECOND

#: Each cloud has one point, and its number decides in which of so many beams.
BEAMS = 360
BOTH: dict[str, Any] = {"topics": ["/front:=/scan", "/rear:=/scan"], "target_frame": "base_link"}


class Cloud(NamedTuple):
    """A cloud on its way to a recording: seconds from the beginning, and by how much its stamp is off, nanoseconds."""

    topic: str
    at: float
    off_ns: int = 0


def clouds(topic: str, seconds: Iterable[float], off_ns: Callable[[float], int] = lambda _: 0) -> list[Cloud]:
    return [Cloud(topic, at, off_ns(at)) for at in seconds]


def tenths(begin: float, end: float, phase: float = 0.0) -> list[float]:
    return [round(number / 10 + phase, 3) for number in range(round(begin * 10), round(end * 10))]


def recorded(path: Path, found: Iterable[Cloud], points: int = 1, *, moving: float = 0.0) -> Path:
    """Write an MCAP file; with ``moving`` seconds of odometry."""
    still = (0.0, 0.0, 0.0)
    static = [("base_link", frame, T0, still) for frame in ("front", "rear")]
    items = [Item(Stream("/tf_static", TF), T0 - SECOND, {2: transforms(static, 2)})]
    for number in range(round(-5 * bool(moving)), round(10 * moving)):
        time_ns = T0 + number * SECOND // 10
        items.append(Item(Stream("/tf", TF), time_ns, {2: transforms([("odom", "base_link", time_ns, still)], 2)}))
    streams = {topic: Stream(topic, CLOUD) for topic in ("/front", "/rear")}
    for number, (topic, at, off_ns) in enumerate(found):
        time_ns = T0 + round(at * 1e9)
        angle = np.radians(0.5 + number % BEAMS)
        xyz = np.tile(np.array([2 * np.cos(angle), 2 * np.sin(angle), 0.5], "<f4"), (points, 1))
        data = cloud(xyz, 2, stamp_ns=time_ns + off_ns, frame_id=topic.removeprefix("/"))
        items.append(Item(streams[topic], time_ns + 5_000_000, {2: data}))
    items.sort(key=lambda each: (each.log_time_ns, each.stream.topic))
    declared = dict.fromkeys([*(each.stream for each in items), *streams.values()])
    return write_mcap(path, Recording(tuple(declared), tuple(items)))


class Made(NamedTuple):
    """The scans of a conversion: their stamps as seconds from the beginning, how many clouds each has; its report."""

    stamps: list[float]
    sizes: list[int]
    report: pc2scan.Report


def made(source: Path, **options: Any) -> Made:
    destination = source.with_name("scans.mcap")
    report = pc2scan.convert(source, destination, only_scans=True, overwrite=True, beams=BEAMS, **options)
    scans = list(pc2scan.scans(destination))
    stamps = [round((scan.stamp_ns - T0) / 1e9, 3) for scan in scans]
    return Made(stamps, [int(np.isfinite(scan.ranges).sum()) for scan in scans], report)


GATHERED: list[tuple[dict[str, Any], int, int]] = [
    ({"accumulate": 1}, 10, 20), ({"every": 1}, 1, 20), ({"accumulate": "3clouds"}, 10, 6), ({}, 10, 2)
]  # fmt: skip


@pytest.mark.parametrize(
    ("speaks", "options", "scans", "size"),
    sampled([(speaks, *each) for each in GATHERED for speaks in ((0, 2), (10, 15))], 3),
)
def test_scans_are_made_while_the_leading_lidar_speaks(
    speaks: tuple[int, int],
    options: dict[str, Any],
    scans: int,
    size: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(grouping, "MAX_HELD_BYTES", 700_000)
    begin, end = speaks
    found = [*clouds("/front", tenths(begin, end)), *clouds("/rear", tenths(0, 15, 0.03))]
    source = recorded(tmp_path / "d.mcap", sorted(found, key=lambda each: each.at), 1000, moving=16.0)
    done = made(source, **BOTH, **options, fixed_frame="odom")
    assert len(done.stamps) == (end - begin) * scans
    assert all(begin <= stamp < end for stamp in done.stamps)
    assert done.sizes[-2] == size


@pytest.mark.parametrize(("speaks", "options", "left"), rows(TABLES, "silent leads"))
def test_what_is_lost_while_the_lead_is_silent_is_said(
    speaks: tuple[int, int], options: dict[str, Any], left: str, tmp_path: Path
) -> None:
    found = [*clouds("/front", tenths(*speaks)), *clouds("/rear", tenths(0, 15, 0.03))]
    source = recorded(tmp_path / "d.mcap", sorted(found, key=lambda each: each.at))
    report = made(source, **BOTH, **options).report
    expected = re.sub(r"\{(.*?)\}", lambda at: stamp_text(T0 + round(float(at[1]) * 1e9)), left)
    # A warning says what scans are made for.
    (said,) = (each for each in (*report.warnings, *report.notes) if "messages of /rear are" in each)
    assert said == expected
    assert not any("messages of /front" in each for each in report.warnings)
    (entry,) = (topic for topic in report.as_dict()["topics"] if topic["topic"] == "/rear")
    assert entry["joined"]["longest_unmatched"]["number"] == int(expected.partition("; ")[2].partition(" ")[0])


def test_stamps_that_jump_back_begin_a_new_series(tmp_path: Path) -> None:
    source = recorded(tmp_path / "d.mcap", clouds("/front", tenths(0, 30), lambda at: 0 if at < 10 else -HOUR))
    one = {"topics": "/front:=/scan"}
    turns = made(source, **one, every=1)
    assert turns.sizes == [10] * 30
    gathered = made(source, **one, accumulate=1)
    assert gathered.sizes == [*range(1, 10), *[10] * 91, *range(1, 10), *[10] * 191]
    for done in (turns, gathered):
        (warning,) = (each for each in done.report.warnings if "jump" in each)
        assert warning == (
            "the stamps of /front jump back by 3,600 s at 1699996410.000000000, compared with their log times: no scan "
            "on /scan has messages from before and after"
        )
        (entry,) = (topic for topic in done.report.as_dict()["topics"] if topic["topic"] == "/front")
        assert entry["joined"]["jumped"] == 1
