"""Buffers are used again, but never while anything refers to them."""

from __future__ import annotations

import numpy as np
import pytest

from pc2scan.files.source_file import STORED, UNPACKED, lend


@pytest.fixture(autouse=True)
def _no_free_buffers() -> None:
    for pool in (STORED, UNPACKED):
        pool.clear()


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
    # And again and again, for less.
    for _ in range(9):
        assert id(lend(5).obj) == memory
    assert [len(each) for each in UNPACKED] == [1 << 20, 1 << 20]
