"""Declared times of chunks that are wrong: they hide no message from a cut."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.bags.opening import open_recording
from support import mcap_files as mcap
from support import rosbag1_files as bag

if TYPE_CHECKING:
    from pathlib import Path

TIMES = (10, 20, 30)


def bag_of(path: Path, declared: tuple[int, int]) -> Path:
    """Three chunks with a message each, whose index has other times for the second."""
    chunks = [bag.chunk(bag.message(time_ns)) for time_ns in TIMES]
    infos, position = b"", bag.FIRST_CHUNK
    for chunk, span in zip(chunks, ((10, 10), declared, (30, 30)), strict=True):
        infos += bag.chunk_info(position, *span, {0: 1})
        position += len(chunk)
    path.write_bytes(bag.bag_header(position, 1, 3) + b"".join(chunks) + bag.connection_record() + infos)
    return path


def mcap_of(path: Path, declared: tuple[int, int]) -> Path:
    mcap.write(path, [(0, time_ns, b"data") for time_ns in TIMES], topics=1, chunk_size=1)
    spans = iter(((10, 10), declared, (30, 30)))

    def change(index: Any) -> None:
        index.message_start_time, index.message_end_time = next(spans)

    # Without a checksum of the summary.
    return mcap.altered_index(path, "ChunkIndex", change, every=True, crc=False)


@pytest.mark.parametrize("declared", [(25, 25), (12, 12)])
@pytest.mark.parametrize("make", [bag_of, mcap_of])
def test_wrong_times_beside_a_cut_hide_no_message(make: Any, declared: tuple[int, int], tmp_path: Path) -> None:
    path = make(tmp_path / ("a.bag" if make is bag_of else "a.mcap"), declared)
    with closing(open_recording(path)) as reader:
        assert [message.log_time_ns for message in reader.messages(None, 15, 22)] == [20]
        assert ["has log times" in damage.what for damage in reader.damage] == [True]
