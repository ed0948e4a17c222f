"""The corpus is the same each time."""

from __future__ import annotations

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
