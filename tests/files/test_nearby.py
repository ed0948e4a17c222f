from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.files.nearby import missing_hint

if TYPE_CHECKING:
    from pathlib import Path


def test_a_name_that_nearly_matches(tmp_path: Path) -> None:
    (tmp_path / "drive.bag").touch()
    assert missing_hint(tmp_path / "drvie.bag") == f"did you mean {tmp_path / 'drive.bag'}?"
    assert missing_hint(tmp_path / "nothing_like_it") is None


def test_what_there_is_instead(tmp_path: Path) -> None:
    for name in ("a.bag", "b.bag", "c.mcap", "d.mcap", "notes.txt"):
        (tmp_path / name).touch()
    hint = missing_hint(tmp_path / "recording", (".bag", ".mcap"))
    assert hint == f"the folder has {', '.join(str(tmp_path / n) for n in ('a.bag', 'b.bag', 'c.mcap'))} and 1 more"


def test_a_directory_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    assert missing_hint(tmp_path / "recording" / "a.bag") == f"did you mean {tmp_path / 'recordings'}?"
    assert missing_hint(tmp_path / "x" / "y" / "z" / "a.bag") is None
