"""Which files are the parts of one recording, and which are several."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

from pc2scan.bags.folders import are_named_as_parts, overlap_warnings, recordings_in
from pc2scan.bags.opening import open_recording
from pc2scan.errors import UsageError
from support.rosbag2_files import write_metadata, write_storage
from support.tables import rows

TABLES = Path(__file__).with_name("folders.txt")

SECOND = 1_000_000_000
MINUTE = 60 * SECOND


@pytest.mark.parametrize(("names", "parts"), rows(TABLES, "names, and whether they are parts of one recording"))
def test_names_of_parts(names: list[str], parts: bool) -> None:
    assert are_named_as_parts([Path(name) for name in names]) is parts


def test_recordings_of_a_folder(tmp_path: Path) -> None:
    for name in ("b10.bag", "b9.bag", "c.BAG.active", "d.mcap.zst", "e.db3", "e.db3-wal", "notes.txt", "._b9.bag"):
        (tmp_path / name).touch()
    for name in ("f", "g", "empty"):
        (tmp_path / name).mkdir()
    write_metadata(tmp_path / "f", 8, ["f_0.db3"])
    (tmp_path / "g" / "g_0.mcap").touch()
    names = [path.name for path in recordings_in(tmp_path)]
    assert names == ["b9.bag", "b10.bag", "c.BAG.active", "d.mcap.zst", "e.db3", "f", "g"]


@pytest.mark.parametrize(
    ("first", "second", "why"), rows(TABLES, "topics and seconds of two parts, and why they are two recordings")
)
def test_parts_without_metadata_are_one_or_several(
    first: list[tuple[str, float]], second: list[Any], why: str, tmp_path: Path
) -> None:
    before, later = ([(row[0], round(row[1] * SECOND)) for row in part if len(row) == 2] for part in (first, second))
    write_storage(tmp_path / "x_0.mcap", before)
    write_storage(tmp_path / "x_1.mcap", later, **({"msgtype": second[-1]} if len(later) < len(second) else {}))
    if not why:
        with closing(open_recording(tmp_path)) as reader:
            assert len(list(reader.messages())) == len(first) + len(second)
        return
    with pytest.raises(UsageError, match="holds 2 recordings") as caught:
        open_recording(tmp_path)
    assert why in caught.value.message


def test_a_part_may_be_missing(tmp_path: Path) -> None:
    write_storage(tmp_path / "x_0.mcap", [("/a", 5)])
    write_storage(tmp_path / "x_2.mcap", [("/a", 5 + 10 * MINUTE)])
    with closing(open_recording(tmp_path)) as reader:
        assert reader.summary.message_count == 2


def warnings_of(*paths: Path) -> list[str]:
    with ExitStack() as stack:
        return overlap_warnings([stack.enter_context(closing(open_recording(path))) for path in paths])


def test_recordings_that_overlap_are_warned_of(tmp_path: Path) -> None:
    one, other, later, first, second, elsewhere, latched = paths = [
        tmp_path / f"{name}.mcap" for name in ("a", "b", "c", "x_0", "x_1", "other", "latched")
    ]
    for path, written in zip(
        paths,
        (
            [("/a", 0), ("/a", 2 * SECOND)],
            [("/a", SECOND), ("/a", 3 * SECOND)],
            [("/a", 4 * SECOND)],
            [("/a", 0), ("/a", 2 * SECOND)],
            [("/a", 2 * SECOND - 1), ("/a", 3 * SECOND)],
            [("/b", 0), ("/b", 3 * SECOND)],
            [("/a", 0), ("/a", 3 * SECOND)],
        ),
        strict=True,
    ):
        write_storage(path, written, **({} if path == latched else {"qos": ""}))
    (warning,) = warnings_of(one, other, later)
    assert warning.startswith(f"{one} and {other} overlap in time, by up to 1.000 s, on /a: ")
    assert warnings_of(one, later) == warnings_of(other, later) == warnings_of(one) == []
    # Parts, and recordings of other topics or of what is latched, may overlap.
    assert warnings_of(first, second, elsewhere, latched) == []
