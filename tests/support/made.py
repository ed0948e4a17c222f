"""Recordings that a case of a transcript may name, made when it does: those of `support.builders`, and spoilt ones."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import zstandard
from mcap.writer import IndexType
from mcap.writer import Writer as McapLibraryWriter

from support import ROOT
from support.builders import (
    CLOUD,
    CONTENT,
    POINTS,
    SCAN,
    SECOND,
    SOURCES,
    STRING,
    T0,
    Item,
    Recording,
    Stream,
    cloud,
    item,
    points_of,
    scan,
    string,
    write_mcap,
    write_rosbag1,
)
from support.situations import MISTAKES

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def _second_cloud(make: Callable[[int, int], bytes]) -> Recording:
    """The common content, the second cloud replaced."""
    second = CONTENT.of("/points")[1]
    bad = item(POINTS, second.log_time_ns, make, seq=1)
    return Recording(CONTENT.streams, tuple(bad if entry is second else entry for entry in CONTENT.items))


def _spoilt(**how: object) -> Recording:
    stamp_ns = T0 + SECOND // 10
    return _second_cloud(lambda g, s: cloud(points_of(1), g, seq=s, stamp_ns=stamp_ns, **how))  # type: ignore[arg-type]


def _two_lidars() -> Recording:
    rear = Stream("/rear/points", CLOUD)
    more = item(rear, T0 + 9, lambda g, s: cloud(points_of(9), g, seq=s))
    return Recording((*CONTENT.streams, rear), (*CONTENT.items, more))


def _one_of_many() -> Recording:
    """150 clouds without z, and one that has it."""

    def made(step: int) -> Item:
        names = ("x", "y", "z" if step == 150 else "i")
        return item(POINTS, T0 + step, lambda g, s: cloud(points_of(0, 5), g, seq=s, names=names), step)

    return Recording((POINTS,), tuple(map(made, range(151))))


def _no_stamps() -> Recording:
    made = (item(POINTS, T0 + step, lambda g, s: cloud(points_of(0), g, seq=s, stamp_ns=0), step) for step in range(3))
    return Recording((POINTS,), tuple(made))


def _short_scan() -> Recording:
    """Two scans, and one whose data is short."""
    stream = Stream("/base_scan", SCAN)
    ranges = np.full(31, 2.0, np.float32)
    whole = [item(stream, T0 + step, lambda g, s: scan(ranges, g, seq=s), step) for step in range(2)]
    short = replace(whole[0], log_time_ns=T0 + 5, data={1: whole[0].data[1][:-40]})
    return Recording((stream,), (*whole, short))


def _rolled_over() -> Recording:
    """A recording whose last log time is negative, so that MCAP's unsigned number is that of the year 2554."""
    *items, last = SHORT.items
    return replace(SHORT, items=(*items, replace(last, log_time_ns=2**64 - 5)))


def _last_changed(topic: str, data: bytes) -> Recording:
    """The common content with another last message on a topic, in ROS 2."""
    last = CONTENT.of(topic)[-1]
    return replace(
        CONTENT, items=tuple(replace(each, data={2: data}) if each is last else each for each in CONTENT.items)
    )


def _raised_point() -> bytes:
    """The last cloud of the common content, a point half a metre higher."""
    points = points_of(2)
    points[11, 2] += np.float32(0.5)
    return cloud(points, 2, seq=2, stamp_ns=T0 + 2 * SECOND // 10)


def _fewer_batteries() -> Recording:
    return replace(CONTENT, items=tuple(each for each in CONTENT.items if each not in CONTENT.of("/battery")[1:]))


def _talk() -> Recording:
    stream = Stream("/chatter", STRING)
    return Recording((stream,), (item(stream, T0, lambda g, _: string("hello", g)),))


def _built(kind: str) -> Callable[[Path], object]:
    return lambda path: SOURCES[kind](path.parent, CONTENT).rename(path)


NO_Z, SHORT = _spoilt(names=("x", "y", "intensity")), _spoilt(cut=100)

#: Ways to write an MCAP file, from counted in its statistics to counted nowhere.
FORMS: dict[str, dict[str, Any]] = {
    "counted": {},
    "indexed": {"use_statistics": False},
    "unchunked": {"use_chunking": False, "use_statistics": False},
    "unindexed": {"use_statistics": False, "index_types": IndexType.NONE},
}


def write_json(path: Path, form: str = "counted", *, messages: int = 40, text: str = "/text") -> Path:
    """Write /state and /log in JSON, which a bag cannot hold, /empty in JSON without messages, and a topic of ROS 1."""
    with path.open("wb") as file:
        writer = McapLibraryWriter(file, chunk_size=200, **FORMS[form])
        writer.start("ros1", "tests")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        ids = [writer.register_channel(topic, "json", 0, {}) for topic in ("/state", "/log", "/empty")]
        ros1 = writer.register_channel(text, "ros1", schema, {})
        for number in range(messages):
            writer.add_message(ids[number % 4 == 0], T0 + number * SECOND // 10, b'{"n": %d}' % number, T0, number)
        for number in range(7):
            writer.add_message(ros1, T0 + (messages + number) * SECOND // 10, b"\x01\0\0\0a", T0, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


#: What makes a recording at a path, by its name.
MADE: dict[str, Callable[[Path], object]] = {
    **MISTAKES,
    "content.bag": lambda path: write_rosbag1(path, CONTENT),
    "content_of_ros1.mcap": _built("mcap-ros1"),
    "content.mcap": _built("mcap-lz4"),
    "content.db3": _built("db3"),
    "content_of_sqlite3": _built("rosbag2-sqlite3-v8"),
    "content_of_mcap": _built("rosbag2-mcap-v8"),
    "two_lidars.bag": lambda path: write_rosbag1(path, _two_lidars()),
    "no_z.bag": lambda path: write_rosbag1(path, NO_Z),
    "no_z.mcap": lambda path: write_mcap(path, NO_Z),
    "short.bag": lambda path: write_rosbag1(path, SHORT),
    "rolled_over.mcap": lambda path: write_mcap(path, _rolled_over()),
    "short.mcap": lambda path: write_mcap(path, SHORT),
    "no_stamps.bag": lambda path: write_rosbag1(path, _no_stamps()),
    "cut.bag.zst": lambda path: path.write_bytes(
        zstandard.compress((ROOT / "fixtures/hall.bag").read_bytes())[:250_000]
    ),
    "one_of_many.bag": lambda path: write_rosbag1(path, _one_of_many()),
    "other_chatter.mcap": lambda path: write_mcap(path, _last_changed("/chatter", string("hello 3", 2))),
    "raised_point.mcap": lambda path: write_mcap(path, _last_changed("/points", _raised_point())),
    "fewer_batteries.mcap": lambda path: write_mcap(path, _fewer_batteries()),
    "talk.mcap": lambda path: write_mcap(path, _talk()),
    "short_scan.bag": lambda path: write_rosbag1(path, _short_scan()),
    **{f"json_{form}.mcap": partial(write_json, form=form) for form in FORMS},
    "json_without_messages.mcap": partial(write_json, messages=0),
    "json_and_ros1.mcap": partial(write_json, messages=1, text="/log"),
}
