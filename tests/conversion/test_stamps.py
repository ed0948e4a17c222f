"""Lidars on their own clock: with corrected stamps, everything is as if the clock had been right."""

from __future__ import annotations

import warnings
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.messages.laserscan import decode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from pc2scan.messages.stamps import move_point_times
from support.builders import SECOND, write_mcap, write_rosbag1
from support.tables import rows
from support.worlds.posed import recording

TABLES = Path(__file__).with_name("stamps.txt")
WRITERS: dict[str, Any] = {"mcap": write_mcap, "bag": write_rosbag1}
HEIGHTS: dict[str, Any] = {"min_height": -20.0, "max_height": 20.0}

#: What a lidar's clock is ahead: since boot, TAI, another year, and a little.
OFFSETS = {
    "-1699999000s": -1_699_999_000 * SECOND,
    "37s": 37 * SECOND,
    "31536000.25": 31_536_000 * SECOND + SECOND // 4,
    "-120ms": -120_000_000,
}


def messages(path: Path, topic: str) -> list[tuple[int, bytes]]:
    with closing(open_recording(path)) as reader:
        own = [each for each in reader.connections if each.topic == topic]
        return [(each.log_time_ns, bytes(each.data)) for each in reader.messages(own)]


def converted(path: Path, name: str, **options: Any) -> tuple[Path, pc2scan.Report]:
    out = path.with_name(f"{name}{path.suffix}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pc2scan.RecordingWarning)
        how: dict[str, Any] = {"target_frame": "odom", "keep_clouds": True} | HEIGHTS | options
        return out, pc2scan.convert(path, out, **how)


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("text", OFFSETS)
def test_a_corrected_clock_is_the_right_clock_to_the_bit(text: str, suffix: str, tmp_path: Path) -> None:
    right = WRITERS[suffix](tmp_path / f"right.{suffix}", recording("tf"))
    wrong = WRITERS[suffix](tmp_path / f"wrong.{suffix}", recording("tf", offset_ns=OFFSETS[text]))
    expected, _ = converted(right, "a")
    undone = text.removeprefix("-") if text.startswith("-") else f"-{text}"
    found, report = converted(wrong, "b", time_offset=undone)
    assert not any("clock" in text for text in report.warnings)
    for topic in ("/scan", "/points", "/tf"):
        assert messages(found, topic) == messages(expected, topic), topic


@pytest.mark.parametrize("suffix", WRITERS)
def test_log_times_become_stamps(suffix: str, tmp_path: Path) -> None:
    wrong = WRITERS[suffix](tmp_path / f"wrong.{suffix}", recording("tf", offset_ns=-1_600_000_000 * SECOND))
    found, _ = converted(wrong, "b", stamps="log")
    scans = messages(found, "/scan")
    assert len(scans) == 5
    form = {"mcap": "cdr", "bag": "ros1"}[suffix]
    assert [decode_laserscan(data, form).stamp_ns for _, data in scans] == [log for log, _ in scans]
    assert [decode_pointcloud2(data, form).stamp_ns for _, data in messages(found, "/points")] == [
        log for log, _ in scans
    ]


def test_an_offset_is_measured_against_the_transforms(tmp_path: Path) -> None:
    """Clouds are logged 5 ms after their stamps, transforms 2 ms."""
    for text, offset_ns in OFFSETS.items():
        wrong = write_mcap(tmp_path / "w.mcap", recording("tf", offset_ns=offset_ns))
        found, report = converted(wrong, "b", time_offset="auto", overwrite=True)
        stamps = [decode_laserscan(data, "cdr").stamp_ns for _, data in messages(found, "/scan")]
        logged = [log for log, _ in messages(found, "/scan")]
        (note,) = (note for note in report.notes if "time_offset" in note)
        if text == "-120ms":
            # A slow driver may delay messages by as much.
            assert "time_offset is 0: its first stamps fit the stamps of /tf" in note
            continue
        assert {log - stamp for log, stamp in zip(logged, stamps, strict=True)} == {2_000_003}
        assert f"time_offset is {-offset_ns / 1e9 + 0.003:.3f} s, measured against the stamps of /tf" in note
        # What is printed can be typed.
        again, _ = converted(wrong, "c", time_offset=note.split("time_offset=")[1].strip("`"), overwrite=True)
        assert messages(again, "/scan") == messages(found, "/scan")


@pytest.mark.parametrize("kind", ["<f8", "<u4", "<f4"])
@pytest.mark.parametrize("shift_s", [-1_600_000_000, 37, 86_400])
def test_absolute_point_times_are_moved(kind: str, shift_s: int) -> None:
    from pc2scan.messages.pointcloud2 import PointField
    from support.encoded import encode_pointcloud2

    stamp_ns = 1_700_000_000 * SECOND
    unit = {"<f8": 1.0, "<u4": 1e9, "<f4": 1.0}[kind]
    # Only 64 bits hold times since 1970; the others count from the stamp.
    begin = 1_700_000_000.0 if kind == "<f8" else 0.0
    times = [begin + share for share in (0.0125, 0.0, 0.1)]
    values = np.array([(i, 0, 0, round(time * unit) if "u" in kind else time) for i, time in enumerate(times)],
                      [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", kind)])  # fmt: skip
    values["t"][1] = 0
    code = {"<f8": 8, "<u4": 6, "<f4": 7}[kind]
    fields = [*(PointField(name, 4 * i, 7) for i, name in enumerate("xyz")), PointField("t", 12, code)]
    data = bytearray(
        encode_pointcloud2(
            serialization="cdr", sequence=0, stamp_ns=stamp_ns, frame_id="a", fields=fields,
            point_step=values.itemsize, data=values.tobytes(), is_dense=True,
        )
    )  # fmt: skip
    move_point_times(data, "cdr", shift_s * SECOND)
    moved = decode_pointcloud2(bytes(data), "cdr").field("t")
    expected = values["t"].copy()
    if kind == "<f8":
        expected[[0, 2]] += shift_s
    assert moved.tolist() == expected.tolist()


@pytest.mark.parametrize(("options", "said"), rows(TABLES, "wrong options"))
def test_wrong_options_say_what_to_type(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", recording("tf"))
    with pytest.raises(pc2scan.Pc2ScanError) as caught:
        pc2scan.convert(path, tmp_path / "b.mcap", **options)
    assert said in f"{caught.value} {caught.value.hint}"
    assert not (tmp_path / "b.mcap").exists()
