"""What is left of damaged databases: cut at every page and between, pages overwritten, logs beside them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest

from pc2scan.bags.rosbag2.sqlite3.read import Sqlite3Reader
from pc2scan.errors import DamageError
from support.sqlite3_files import build, recovered, rosbag2_pages

if TYPE_CHECKING:
    from pathlib import Path
pytestmark = pytest.mark.usefixtures("_pages")


@pytest.fixture
def _pages(monkeypatch: pytest.MonkeyPatch) -> None:
    rosbag2_pages(monkeypatch)


@pytest.mark.slow
def test_cut_at_many_pages(tmp_path: Path) -> None:
    complete = build(tmp_path / "a.db3")
    data = (tmp_path / "a.db3").read_bytes()
    path = tmp_path / "b.db3"
    sizes = {0, 1, 2048}
    found = []
    for size in sorted({page + more for page in range(0, len(data), 21 * 4096) for more in sizes}):
        if not 16 <= size < len(data):
            continue
        path.write_bytes(data[:size])
        try:
            rows, damage = recovered(path)
        except DamageError as err:
            # The first page has the schema, and the topics are in the next ones: before them there is nothing.
            assert size < 7 * 4096, size
            assert "nothing of it can be recovered" in err.message  # noqa: PT017
            found.append(0)
            continue
        assert Counter(rows) <= Counter(complete), size
        assert rows == sorted(rows, key=lambda row: row[1])
        assert damage, size
        assert damage[0].bytes_lost == len(data) - size
        found.append(len(rows))
        with pytest.raises(DamageError, match="is cut off"):
            Sqlite3Reader(path, strict=True)
    assert found == sorted(found)
    # What lies in front of a cut is all there is to be had: rows in proportion to bytes, or nearly.
    assert found[len(found) // 2] > len(complete) // 4
    assert found[-1] > len(complete) * 3 // 4


def test_of_an_overwritten_page_only_its_own_rows_are_lost(tmp_path: Path) -> None:
    complete = build(tmp_path / "a.db3")
    data = (tmp_path / "a.db3").read_bytes()
    path = tmp_path / "b.db3"
    for page in range(8, len(data) // 4096, 5):
        broken = bytearray(data)
        broken[page * 4096 : (page + 1) * 4096] = b"\xa5" * 4096
        path.write_bytes(broken)
        rows, damage = recovered(path)
        found = Counter(rows)
        # A page has about ten of these messages; one in a chain of pages may be found with the page's garbage in it.
        lost = Counter(complete) - found
        assert lost.total() <= 40, page
        if len(rows) < len(complete):
            assert damage, page
        assert rows == sorted(rows, key=lambda row: row[1])


def test_a_message_whose_time_the_index_has_lost_is_read(tmp_path: Path) -> None:
    complete = build(tmp_path / "a.db3")
    data = (tmp_path / "a.db3").read_bytes()
    # The kinds of an entry's time and row, and the time.
    kinds, time = b"\x03\x03\x01", complete[50][1].to_bytes(3, "big")
    assert data.count(kinds + time) == 1
    (tmp_path / "b.db3").write_bytes(data.replace(kinds + time, b"\x03\x00\x01" + time))
    rows, damage = recovered(tmp_path / "b.db3")
    assert (Counter(rows), len(damage)) == (Counter(complete), 1)
