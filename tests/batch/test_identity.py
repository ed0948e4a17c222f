"""What a file is recognised by."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from pc2scan.batch.identity import Identity, checksum_of, identity_of

if TYPE_CHECKING:
    from pathlib import Path


def test_names_sizes_and_times(tmp_path: Path) -> None:
    file = tmp_path / "a.bag"
    file.write_bytes(b"12345")
    os.utime(file, ns=(1, 1_700_000_000_123_456_789))
    identity = identity_of([file, tmp_path / "missing"])
    assert identity.files == (("a.bag", 5, 1_700_000_000_123_456_789),)
    assert Identity.from_json(identity.as_json()) == identity
    assert identity.size_bytes == 5
    assert identity_of([tmp_path / "missing"]).files == ()
    os.utime(file, ns=(1, 2))
    assert identity_of([file]) != identity
    assert identity_of([file]).has_sizes_of(identity)


def test_a_folder_has_all_files_in_it(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    for name in ("b", "a", "below/c", "x.db3-shm"):
        (tmp_path / name).write_bytes(b"1")
    (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
    assert [name for name, _, _ in identity_of([tmp_path]).files] == ["a", "b", os.path.join("below", "c")]  # noqa: PTH118
    for number in range(200):
        (tmp_path / f"{number}.bin").write_bytes(b"22")
    many = identity_of([tmp_path])
    assert many.files[0][:2] == ("203 files", 403)
    (tmp_path / "7.bin").unlink()
    assert identity_of([tmp_path]) != many


def test_the_log_of_a_database_belongs_to_it(tmp_path: Path) -> None:
    database = tmp_path / "a.db3"
    database.write_bytes(b"1")
    alone = identity_of([database])
    (tmp_path / "a.db3-wal").touch()
    assert identity_of([database]) == alone
    (tmp_path / "a.db3-wal").write_bytes(b"more")
    assert identity_of([database]) != alone


def test_checksums_are_of_content(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(b"content")
    assert checksum_of([tmp_path / "a"]) == checksum_of([tmp_path / "b"])
    (tmp_path / "b").write_bytes(b"other..")
    assert checksum_of([tmp_path / "a"]) != checksum_of([tmp_path / "b"])
    whole = checksum_of([tmp_path])
    (tmp_path / "b").rename(tmp_path / "c")
    assert checksum_of([tmp_path]) != whole
