"""``pc2scan diff``: nothing between forms of one content, everything between contents."""

from __future__ import annotations

import json
import re
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from support import sampled
from support.builders import (
    CONTENT,
    SCAN,
    SECOND,
    SOURCES,
    T0,
    Item,
    Recording,
    Stream,
    item,
    scan,
    write_mcap,
    write_rosbag1,
)
from support.command import run

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SCANS = Stream("/scan", SCAN, "/scanner")
BEAMS = 181
Ranges = np.ndarray[Any, np.dtype[np.float32]]


def ranges(step: int) -> Ranges:
    values = np.random.default_rng(step).uniform(0.5, 29, BEAMS).astype(np.float32)
    values[::7] = np.inf
    return values


TEN = [ranges(step) for step in range(10)]


def stamp_of(step: int) -> int:
    return T0 - 77 + step * SECOND // 10


def scan_item(values: Ranges, log_time_ns: int = T0, *, stream: Stream = SCANS, **header: Any) -> Item:
    return item(stream, log_time_ns, lambda ros_version, _: scan(values, ros_version, **header))


def recording(values: Sequence[Ranges] = TEN, stamps: Sequence[int] | None = None, stream: Stream = SCANS) -> Recording:
    """Scans a tenth of a second apart; ``stamps`` says whose header each has."""
    items = [
        scan_item(v, T0 + step * SECOND // 10, stream=stream, seq=step, stamp_ns=stamp_of(stamp))
        for step, (v, stamp) in enumerate(zip(values, stamps or range(len(values)), strict=True))
    ]
    return Recording((stream,), tuple(items))


def changed(*beams: tuple[int, int, float]) -> Recording:
    """The ten scans with other values of some beams: number of the scan, of the beam, and value."""
    values = [v.copy() for v in TEN]
    for number, beam, value in beams:
        values[number][beam] = value
    return recording(values)


# --- nothing ---


@cache
def source(kind: str, folder: Path) -> Path:
    (folder / kind).mkdir()
    return SOURCES[kind](folder / kind, CONTENT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sources")


@pytest.mark.parametrize(("kind", "against"), sampled([(kind, "bag-lz4") for kind in SOURCES], 3))
def test_the_form_makes_no_difference(kind: str, against: str, folder: Path) -> None:
    found = pc2scan.diff(source(against, folder), source(kind, folder), all_topics=True)
    # Storages of before ROS 2 Iron do not define the custom type: between ROS versions its bytes cannot be compared.
    undefined = {f"rosbag2-sqlite3-v{version}" for version in (2, 4, 5)}
    unknown = kind in undefined and against == "bag-lz4"
    assert [topic.name for topic in found.topics if not topic.same] == (["/battery"] if unknown else []), str(found)
    assert {topic.name for topic in found.topics} == {stream.topic for stream in CONTENT.streams}
    assert sum(topic.matched for topic in found.topics) == len(CONTENT.items)
    assert ("not decoded" in str(found)) == unknown


# --- scans ---


def bit() -> Recording:
    values = [v.copy() for v in TEN]
    values[4].view(np.uint32)[90] ^= 1
    return recording(values)


def without(dropped: int) -> Recording:
    kept = recording()
    return Recording(kept.streams, (*kept.items[:dropped], *kept.items[dropped + 1 :]))


def later(log_ns: int, stamps: int | None = None) -> Recording:
    """Recorded later, with the same stamps, or with others, a nanosecond apart."""

    def of(step: int) -> Item:
        stamp_ns = stamp_of(step) if stamps is None else T0 + stamps + step
        return scan_item(TEN[step], T0 + log_ns + step * SECOND // 10, stamp_ns=stamp_ns)

    return Recording((SCANS,), tuple(map(of, range(10))))


SWAPPED = [0, 1, 2, 4, 3, 5, 6, 7, 8, 9]
THREE = changed((1, 1, TEN[1][1] + 1), (1, 2, TEN[1][2] + 1), (7, 1, TEN[7][1] + 5))
#: Beam 70 had no return and takes its neighbour's: it has shifted.
SHIFTED = changed((2, 70, TEN[2][69]), (2, 69, np.inf), (3, 50, TEN[3][50] + 1))

ONE_BIT = "same=False differing=1 values.ranges.messages=1 values.ranges.changed=1 values.ranges.shifted=0"
WORST = f"values.ranges.worst.index=90 values.ranges.worst.times.stamp_ns={stamp_of(4)} values.ranges.worst.angle=0.0"
ALLOWED = "same=True values.ranges.worst.index=1"

#: Another recording, options, what the JSON says of the only topic, and what the text says.
CHANGES: list[tuple[Recording, str, str, str]] = [
    (bit(), "", f"{ONE_BIT} {WORST}", "1 beam of 1,810|beam 90 (0.00 deg)|different: 1 of 1 topic"),
    (SHIFTED, "", "values.ranges.changed=1 values.ranges.shifted=2", ""),
    (recording([TEN[k] for k in SWAPPED], SWAPPED), "", "moved.count=1 values={} changes.log_time.messages=2", ""),
    # Only the contents change places: both scans differ.
    (recording([TEN[k] for k in SWAPPED]), "", "moved.count=0 differing=2", ""),
    # The allowed share is of all beams. The worst beam differs most.
    (THREE, f"--allow-beams {2.9 / 1810}", "same=False", ""),
    (THREE, f"--allow-beams {3 / 1810}", ALLOWED, "within the allowed"),
    (later(5), "", "same=False", "log_time"),
    (later(0, stamps=0), "", "matched=0", "only in A  10 scans: | and 7 more|hint: no stamp is on both sides"),
    *((without(k), "", f"matched=9 missing.count=1 missing.first.0.stamp_ns={stamp_of(k)}", "") for k in (0, 9)),
]


def value_at(document: Any, path: str) -> str:
    for step in path.split("."):
        document = document[int(step)] if step.isdecimal() else document[step]
    return str(round(document, 6) if isinstance(document, float) else document)


@pytest.mark.parametrize(("other", "options", "expected", "said"), CHANGES)
def test_what_differs_is_found_and_said(
    other: Recording, options: str, expected: str, said: str, tmp_path: Path
) -> None:
    sides = write_mcap(tmp_path / "a.mcap", recording()), write_mcap(tmp_path / "b.mcap", other)
    done, again = (run("diff", *sides, *options.split(), *more) for more in ([], ["--json"]))
    assert (done.stderr, again.stderr) == ("", "")
    found = json.loads(again.stdout)
    assert found["exit_status"] == done.status == again.status == (0 if found["same"] else 1)
    (topic,) = found["topics"]
    topic |= {"same": found["same"]}
    assert [f"{path}={value_at(topic, path)}" for path in re.findall(r"(\S+)=", expected)] == expected.split()
    assert [text for text in said.split("|") if text not in done.stdout] == []


def test_a_recording_with_an_unset_clock(tmp_path: Path) -> None:
    items = tuple(scan_item(v, T0 + step, stamp_ns=0) for step, v in enumerate(TEN))
    one = write_mcap(tmp_path / "a.mcap", Recording((SCANS,), items))
    other = write_mcap(tmp_path / "b.mcap", Recording((SCANS,), (*items[:2], *items[3:])))
    (topic,) = pc2scan.diff(one, other).topics
    assert (topic.missing.count, topic.matched, topic.differing) == (1, 9, 0)


def test_seq_counts_between_ros1_recordings_only(tmp_path: Path) -> None:
    numbered, plain = (Recording((SCANS,), (scan_item(TEN[0], seq=seq),)) for seq in (9, 0))
    a, b = write_rosbag1(tmp_path / "a.bag", numbered), write_rosbag1(tmp_path / "b.bag", plain)
    assert not pc2scan.diff(a, b).same
    assert pc2scan.diff(a, b, ignore="seq").same
    assert pc2scan.diff(a, write_mcap(tmp_path / "b.mcap", plain)).same


# --- topics ---
