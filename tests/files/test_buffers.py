"""Buffers are reused only when no object refers to them, and the bytes that are kept have a limit."""

from __future__ import annotations

import gc
from typing import TYPE_CHECKING

from pc2scan.files import source
from pc2scan.files.source import BorrowedBuffer, BufferPool, ReadBuffer, RetainedMemory, retain

if TYPE_CHECKING:
    import pytest


def borrowed(buffers: BufferPool) -> tuple[BorrowedBuffer, ReadBuffer]:
    taken = BorrowedBuffer(buffers, 1 << 20)
    return taken, taken.buffer


def test_a_buffer_is_free_again_when_nobody_refers_to_the_loan() -> None:
    buffers = BufferPool()
    loan, memory = borrowed(buffers)
    assert not buffers
    del loan
    assert [id(each) for each in buffers] == [id(memory)]
    assert borrowed(buffers)[1] is memory


def test_what_is_kept_is_not_lent_before_the_last_keeper_ends() -> None:
    buffers = BufferPool()
    loan, memory = borrowed(buffers)
    memory[:] = b"7" * len(memory)
    view = memoryview(memory)
    kept = [retain(memory), retain(memory)]
    assert all(kept)
    del loan
    kept.pop()
    other, another = borrowed(buffers)
    another[:] = b"9" * len(another)
    assert set(view) == set(b"7")
    del kept, other
    gc.collect()
    assert len(buffers) == 2


def test_bytes_can_be_kept_and_there_is_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "_MAX_KEPT", RetainedMemory._bytes + 6)
    first = retain(b"123456")
    assert first is not None
    assert retain(b"1") is None
    del first
    assert retain(b"123456") is not None


def test_a_buffer_that_is_lent_no_more_cannot_be_kept() -> None:
    loan, memory = borrowed(BufferPool())
    del loan
    assert retain(memory) is None
