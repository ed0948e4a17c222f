"""The corpus is the same each time."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

from fuzz.decoders import CORPUS
from fuzz.make_corpus import main

if TYPE_CHECKING:
    from pathlib import Path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_two_corpora_are_equal(tmp_path: Path) -> None:
    for name in ("first", "second"):
        main(tmp_path / name)
    first = contents(tmp_path / "first")
    assert first == contents(tmp_path / "second")
    assert first.keys() <= contents(CORPUS).keys()


def test_sqlite_reads_the_log_with_fixed_salts(tmp_path: Path) -> None:
    data = (CORPUS / "pages" / "wal").read_bytes()
    length = int.from_bytes(data[:2], "little")
    (tmp_path / "a.db3").write_bytes(data[2:-length])
    (tmp_path / "a.db3-wal").write_bytes(data[-length:])
    with closing(sqlite3.connect(tmp_path / "a.db3")) as database:
        assert database.execute("SELECT count(*) FROM messages").fetchall() == [(3,)]
