"""Places where nothing can be written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pc2scan.errors import DestinationError, OutputError
from pc2scan.files.staging import staged


def test_impossible_destinations_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for dst, message in [
        (tmp_path / "missing" / "out", "its directory does not exist"),
        (tmp_path / "file" / "out", "file is not a directory"),
        (Path(), "not a name"),
        (Path("/"), "not a name"),
        (tmp_path / "..", "not a name"),
        (Path("/dev/pc2scan-test"), "/dev holds devices"),
        (Path("/proc/self/fd/pc2scan-test"), "/proc/self/fd holds devices"),
    ]:
        with pytest.raises(DestinationError, match=message), staged(dst, overwrite=True):
            pytest.fail("the body must not run")


def test_a_directory_that_is_not_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parent = tmp_path / "closed"
    parent.mkdir()
    parent.chmod(0o500)
    if os.access(parent, os.W_OK):
        # Root may write everywhere.
        monkeypatch.setattr(os, "access", lambda *_: False)
    try:
        with pytest.raises(OutputError, match="not writable"), staged(parent / "out", overwrite=False):
            pytest.fail("the body must not run")
    finally:
        parent.chmod(0o700)
