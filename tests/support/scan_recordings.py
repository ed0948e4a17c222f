"""Recordings of laser scans with whatever is wrong with them, in any container."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from support.builders import SCAN, TF, Item, Recording, Stream, transforms, write_mcap

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

#: The first stamp, nanoseconds, and the time from one scan to the next.
START = 1_700_000_000_000_000_000
STEP = 100_000_000

#: Accepted by everyone: nine beams, the last one at angle_max.
GOOD = LaserScan(0, 0, "laser", -1, 1, 0.25, 0, 0.1, 0.5, 30, np.linspace(1, 9, 9, dtype=np.float32))

#: odom <- base_link <- laser, as rows of a TFMessage without their stamp.
TREE = (("odom", "base_link"), ("base_link", "laser"))


def scans(count: int, pattern: LaserScan = GOOD, step: int = STEP) -> list[LaserScan]:
    """Scans like this one, ``step`` nanoseconds apart."""
    return [replace(pattern, stamp_ns=START + i * step) for i in range(count)]


def recording(
    topics: dict[str, Sequence[LaserScan]],
    tree: Iterable[tuple[str, str]] = TREE,
    *,
    delay: int = 1_000_000,
    static: bool = True,
) -> Recording:
    """Scans, logged ``delay`` nanoseconds after their stamp (or in their order, where stamps are odd), and transforms.

    Transforms that are not static are known from START to 1 s later.
    """
    streams = [Stream(topic, SCAN) for topic in topics]
    items = [
        Item(
            stream,
            START + i * STEP + delay,
            {ros_version: encode_laserscan(scan, name) for ros_version, name in ((1, "ros1"), (2, "cdr"))},
        )
        for stream, content in zip(streams, topics.values(), strict=True)
        for i, scan in enumerate(content)
    ]
    tf = Stream("/tf_static" if static else "/tf", TF, latched=static)
    edges = tuple(tree)
    for stamp in ([START] if static else range(START, START + 1_000_000_001, STEP)) if edges else []:
        rows = [(parent, child, stamp, (0.1, 0.0, 0.2)) for parent, child in edges]
        items.append(Item(tf, stamp, {ros_version: transforms(rows, ros_version) for ros_version in (1, 2)}))
    used = (*streams, *([tf] if edges else []))
    return Recording(used, tuple(sorted(items, key=lambda entry: entry.log_time_ns)))


def write(path: Path, *content: LaserScan, **options: object) -> Path:
    """An MCAP file of scans on /scan."""
    return write_mcap(path, recording({"/scan": content}, **options))  # type: ignore[arg-type]
