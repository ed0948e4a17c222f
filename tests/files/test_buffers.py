"""Buffers are used again, but never while anything refers to them."""

from __future__ import annotations

import numpy as np
import pytest

from pc2scan.files.source import ReadBuffer, UnpackedBuffer, lend


@pytest.fixture(autouse=True)
def _no_free_buffers(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in (ReadBuffer, UnpackedBuffer):
        monkeypatch.setattr(kind, "free", [])


@pytest.mark.parametrize("kept", [lambda view: view[9:99], lambda view: np.frombuffer(view, np.uint8)[9:]])
def test_a_buffer_is_used_again_when_nothing_refers_to_it(kept: object) -> None:
    assert callable(kept)
    view = lend(1 << 20)
    view[:] = b"7" * len(view)
    memory, part = id(view.obj), kept(view)
    del view
    other = lend(1 << 20)
    other[:] = b"9" * len(other)
    assert set(bytes(part)) == set(b"7")
    assert id(other.obj) != memory
    del part
    assert id(lend(1 << 20).obj) == memory
    # And again, for less.
    assert id(lend(5).obj) == memory


def test_stored_and_decompressed_bytes_have_buffers_of_their_own() -> None:
    memory = id(lend(1 << 20).obj)
    assert id(lend(1 << 20, ReadBuffer).obj) != memory
    assert [len(each) for each in UnpackedBuffer.free] == [1 << 20]
    # One that is too small is freed; a very large one is not kept.
    assert len(lend(3 << 20)) == 3 << 20
    assert [len(each) for each in UnpackedBuffer.free] == [3 << 20]
    lend(1 << 25)
    assert len(UnpackedBuffer.free) == 1
