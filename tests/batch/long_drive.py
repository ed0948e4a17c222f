"""A long drive, which a batch converts in pieces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from support.builders import (
    CHARGE,
    CHATTER,
    MOUNT,
    SECOND,
    T0,
    Mcap,
    Recording,
    battery,
    fixed,
    item,
    odometry,
    points,
    string,
    write_db3,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

__all__ = ["WORDS", "WRITERS", "drive"]

#: A conversion that can be cut.
WORDS: dict[str, Any] = {
    "to": "rosbag2",
    "split": "0.5s",
    "min_height": -2,
    "max_height": 2,
    "target_frame": "odom",
}


def drive(steps: int = 60, *, silent: range = range(0), unplaced: range = range(0)) -> Recording:
    """Clouds, transforms and other messages, ten a second.

    In steps of ``silent`` there is nothing, in those of ``unplaced`` clouds are older than all transforms.
    """
    items = [fixed(MOUNT, T0, "lidar", 0.5)]
    for step in range(steps):
        if step in silent:
            continue
        at = T0 + step * SECOND // 10

        # Between two transforms, so that the next one counts.
        stamp_ns = T0 - SECOND if step in unplaced else at + 30_000_000

        def charge(g: int, s: int, at: int = at) -> bytes:
            return battery(g, seq=s, stamp_ns=at)

        items += [
            odometry(at + 2, at, 0.1 * step, step),
            points(at + 5_000_003, stamp_ns, step),
            item(CHATTER, at + 6_000_000, lambda g, s: string(f"hello {s}", g), step),
            item(CHARGE, at + 6_000_000, charge, step),
        ]
    return Recording(tuple(dict.fromkeys(each.stream for each in items)), tuple(items))


WRITERS: dict[str, Callable[[Path, Recording], Path]] = {
    "bag": lambda folder, content: write_rosbag1(folder / "drive.bag", content, "lz4", chunk_size=4_000),
    "mcap": lambda folder, content: write_mcap(folder / "drive.mcap", content, Mcap(chunk_size=4_000)),
    "db3": lambda folder, content: write_db3(folder / "drive.db3", content),
    "rosbag2": lambda folder, content: write_rosbag2(folder / "drive", content),
}
