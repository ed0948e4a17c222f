"""Folders for local copies, and their bounds."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from pc2scan.errors import UsageError
from pc2scan.remote.scratch import ScratchError, ScratchSpace, SizeLimit, scratch_folder

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.skipif(sys.platform == "win32", reason="processes of POSIX")
def test_what_a_killed_run_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from pc2scan.remote.scratch import scratch_folder\n"
        "with scratch_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'copy.bag').write_bytes(b'x')\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False, timeout=60)
    (left,) = tmp_path.iterdir()
    others = [tmp_path / "mine", tmp_path / left.name.replace("pc2scan-", "pc2scan-elsewhere-")]
    for other in others:
        other.mkdir()
    with scratch_folder(tmp_path) as folder:
        assert set(tmp_path.iterdir()) == {folder, *others}
        # Another run does not touch the folder of one that lives.
        with scratch_folder(tmp_path) as second:
            assert set(tmp_path.iterdir()) == {folder, second, *others}
    assert set(tmp_path.iterdir()) == set(others)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be written"), scratch_folder(tmp_path / "none"):
        pass


def test_room_is_shared(tmp_path: Path) -> None:
    room = ScratchSpace(tmp_path, 100)
    freed: list[None] = []
    room.listeners.append(lambda: freed.append(None))
    assert room.reserve(60)
    assert not room.reserve(50)
    room.release(60)
    assert freed == [None]
    assert room.reserve(100)
    assert not room.reserve(1)


def test_a_limit_counts_all_files(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a").write_bytes(b"x" * 60)
    limit = SizeLimit(tmp_path, 100)
    called: list[int] = []
    limit.watching(lambda done, _total, _messages: called.append(done))(1, 2, 3)
    (tmp_path / "b").write_bytes(b"x" * 41)
    with pytest.raises(ScratchError, match="take more than 100 bytes"):
        limit.check()
    assert called == [1]
