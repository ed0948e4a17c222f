"""Recordings that several processes convert in pieces: byte for byte what one conversion writes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from batch.long_drive import WORDS, WRITERS, drive
from pc2scan.batch import pieces
from support import sampled
from support.batches import contents, in_this_process, manifest_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Asserts that pieces are the whole, and whether there are some; returns the line of the manifest."""

    def compare(source: Path, *, is_cut: bool = True, **words: Any) -> dict[str, Any]:
        size = sum(file.stat().st_size for file in source.rglob("*")) if source.is_dir() else source.stat().st_size
        lines = []
        for name, piece_bytes in (("whole", 1 << 62), ("cut", size // 4)):
            monkeypatch.setattr(pieces, "PIECE_BYTES", piece_bytes)
            with in_this_process() as jobs:
                pc2scan.batch(source, tmp_path / name, **{**WORDS, **words})
            assert (sum("piece" in job for job in jobs) > 1) == (is_cut and name == "cut")
            (line,) = manifest_of(tmp_path / name).values()
            # All is the same but times and places.
            del line["started"], line["seconds"]
            if line["output"]:
                line["output"]["files"] = [file[:2] for file in line["output"]["files"]]
            if line["report"]:
                del line["report"]["seconds"], line["report"]["destination"], line["report"]["files"]
            lines.append(line)
        whole, cut = contents(tmp_path / "whole"), contents(tmp_path / "cut")
        assert cut.keys() == whole.keys()
        assert cut == whole
        assert lines[0] == lines[1]
        return lines[1]

    return compare


@pytest.mark.parametrize(("container", "keeps"), sampled([(name, keeps) for keeps in (0, 1) for name in WRITERS], 3))
def test_pieces_are_what_one_conversion_writes(
    container: str, keeps: bool, same: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    source = WRITERS[container](tmp_path, drive(silent=range(22, 38)))
    line = same(source, keep_clouds=bool(keeps), only_scans=not keeps)
    # The last cloud is behind the last transform; ten parts of half a second, and their metadata.
    assert line["outcome"] == "incomplete"
    assert len(line["output"]["files"]) == 11


OPTIONS: tuple[tuple[dict[str, Any], bool], ...] = (
    ({"storage": "sqlite3"}, True),
    ({"target_frame": "", "keep_clouds": True}, True),
    ({"start": 1.2, "end": 4.3, "static_tf": "lidar far 0 0 1 0 0 0"}, True),
    ({"jobs": 1}, True),
    ({"split": "0.15s"}, True),
    # What is not cut.
    ({"repeat_latched": True}, False),
    ({"accumulate": 3}, False),
    ({"split": "20kB"}, False),
    ({"split": None}, False),
)


@pytest.mark.parametrize(("words", "is_cut"), sampled(OPTIONS, 6))
def test_pieces_follow_the_options(
    words: dict[str, Any], is_cut: bool, same: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    same(WRITERS["mcap"](tmp_path, drive()), is_cut=is_cut, **words)


@pytest.mark.parametrize("unplaced", [range(12), range(20, 32), range(60)], ids=str)
def test_files_keep_their_numbers_where_nothing_is_written(
    unplaced: range, same: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    line = same(WRITERS["mcap"](tmp_path, drive(unplaced=unplaced)), only_scans=True)
    assert line["outcome"] == ("failed" if len(unplaced) == 60 else "incomplete"), line["error"]


@pytest.mark.parametrize(
    ("container", "place"), sampled([(name, place) for place in (0.2, 0.5, 0.8) for name in ("bag", "mcap", "db3")], 4)
)
def test_damage_in_a_piece_is_reported_as_of_the_whole(
    container: str, place: float, same: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    source = WRITERS[container](tmp_path, drive())
    data = bytearray(source.read_bytes())
    at = int(len(data) * place)
    data[at : at + 60] = bytes(60)
    source.write_bytes(data)
    # Where damage of a database is found when it is opened, the recording is not cut.
    line = same(source, is_cut=container != "db3" or place == 0.5, keep_clouds=True)
    assert line["outcome"] == "incomplete"


def test_an_error_in_a_piece_is_that_of_the_recording(same: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    line = same(WRITERS["mcap"](tmp_path, drive(unplaced=range(40, 41))), on_error="fail")
    assert line["outcome"] == "failed"
    assert "transform" in line["error"]["message"]
    assert [path.name for path in (tmp_path / "cut").iterdir()] == ["manifest.jsonl"]


def test_progress_is_that_of_all_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = WRITERS["mcap"](tmp_path, drive())
    monkeypatch.setattr(pieces, "PIECE_BYTES", source.stat().st_size // 4)
    seen: list[Any] = []
    with in_this_process() as jobs:
        pc2scan.batch(source, tmp_path / "out", progress=seen.append, **WORDS)
    number = sum("piece" in job for job in jobs)
    shares = [each.bytes_done / each.bytes_total for each in seen if not each.recordings_done]
    assert number > 2
    # Each piece that has ended, in its turn.
    assert [share for share in shares if share] == pytest.approx([n / number for n in range(1, number + 1)], abs=0.001)
    assert seen[-1] == (source.stat().st_size, source.stat().st_size, 1, 1)


@pytest.mark.slow
def test_pieces_are_converted_by_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = WRITERS["mcap"](tmp_path, drive())
    with in_this_process():
        pc2scan.batch(source, tmp_path / "here", **WORDS)
    monkeypatch.setattr(pieces, "PIECE_BYTES", source.stat().st_size // 4)
    pc2scan.batch(source, tmp_path / "there", jobs=2, **WORDS)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
