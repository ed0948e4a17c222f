from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

_map: Any = pytest.importorskip("pc2scan.files._map", reason="maps are for Linux, where a C compiler was")

PAGE = os.sysconf("SC_PAGE_SIZE")
DATA = np.random.default_rng(3).integers(0, 256, 64 * PAGE + 77, np.uint8).tobytes()


@pytest.fixture
def file(tmp_path: Path) -> Iterator[Any]:
    path = tmp_path / "a.bin"
    path.write_bytes(DATA)
    with path.open("rb+") as opened:
        yield opened


def test_its_bytes_are_those_of_the_file(file: Any) -> None:
    mapped = _map.Map(file.fileno(), len(DATA))
    view = memoryview(mapped)
    assert view.readonly
    assert view == DATA
    for offset, length in ((0, 1), (5, 3 * PAGE), (PAGE - 1, 2), (len(DATA) - 9, 9), (len(DATA), 0)):
        mapped.fetch(offset, length)
        assert view[offset : offset + length] == DATA[offset : offset + length]
        mapped.forget(offset, length)
        assert view[offset : offset + length] == DATA[offset : offset + length]
    assert not mapped.missed


def test_pages_are_given_back(file: Any) -> None:
    """The rest of them when the next ones are fetched."""
    size = 64 << 20
    os.ftruncate(file.fileno(), size)
    mapped = _map.Map(file.fileno(), size)

    def resident() -> int:
        lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("Rss:")) << 10

    before = resident()
    view = memoryview(mapped)
    for offset in range(0, size, 4 << 20):
        mapped.fetch(offset, 4 << 20)
        assert sum(view[offset : offset + (4 << 20) : PAGE]) >= 0
        mapped.forget(offset, 4 << 20)
        assert resident() - before < 16 << 20
    for offset in range(0, size, 4 << 20):
        mapped.fetch(offset, 4 << 20)
    assert resident() - before > size // 2
    for offset in range(0, size, 4 << 20):
        mapped.forget(offset, 4 << 20)
    mapped.fetch(0, 1)
    assert resident() - before < 16 << 20


@pytest.mark.parametrize(("offset", "length"), [(-1, 1), (0, -1), (0, len(DATA) + 1), (len(DATA) + 1, 0), (1, 1 << 62)])
def test_what_is_outside_is_refused(offset: int, length: int, file: Any) -> None:
    mapped = _map.Map(file.fileno(), len(DATA))
    for call in (mapped.fetch, mapped.forget):
        with pytest.raises(ValueError, match="outside"):
            call(offset, length)


@pytest.mark.parametrize("length", [0, -1])
def test_there_is_no_map_of_nothing(length: int, file: Any) -> None:
    with pytest.raises(OSError, match=r"Invalid argument|Cannot allocate"):
        _map.Map(file.fileno(), length)


def test_of_a_file_that_was_cut_the_rest_is_zero_and_known_to_be_missed(file: Any) -> None:
    mapped, other = (_map.Map(file.fileno(), len(DATA)) for _ in range(2))
    view = memoryview(mapped)
    assert view[-1] == DATA[-1]
    os.ftruncate(file.fileno(), 3 * PAGE + 5)
    assert view[: 3 * PAGE + 5] == DATA[: 3 * PAGE + 5]
    assert not mapped.missed
    assert bytes(view[4 * PAGE :]) == bytes(len(DATA) - 4 * PAGE)
    assert mapped.missed
    assert not other.missed


def test_what_cannot_be_fetched_is_missed_without_a_look(file: Any) -> None:
    mapped = _map.Map(file.fileno(), len(DATA))
    os.ftruncate(file.fileno(), PAGE)
    mapped.fetch(0, PAGE)
    assert not mapped.missed
    mapped.fetch(PAGE, 1)
    # Linux before 5.14 cannot tell.
    assert mapped.missed or memoryview(mapped)[PAGE] == 0


def test_numpy_may_look_without_the_interpreters_lock(file: Any) -> None:
    mapped = _map.Map(file.fileno(), len(DATA))
    os.ftruncate(file.fileno(), 0)
    assert np.frombuffer(mapped, np.uint8).sum() == 0
    assert mapped.missed


def test_a_view_keeps_it(file: Any) -> None:
    view = memoryview(_map.Map(file.fileno(), len(DATA)))[10:20]
    assert view == DATA[10:20]
    os.ftruncate(file.fileno(), 0)
    assert bytes(view) == bytes(10)


def test_there_are_only_so_many(file: Any) -> None:
    maps: list[Any] = []
    with suppress(OSError):
        while len(maps) < 1000:
            maps.append(_map.Map(file.fileno(), len(DATA)))
    assert 100 < len(maps) < 1000
    del maps[50]
    maps.append(_map.Map(file.fileno(), len(DATA)))
    os.ftruncate(file.fileno(), 0)
    assert memoryview(maps[-1])[0] == 0
    assert [mapped.missed for mapped in maps] == [False] * (len(maps) - 1) + [True]


def test_arguments_have_no_names(file: Any) -> None:
    with pytest.raises(TypeError):
        _map.Map(descriptor=file.fileno(), length=1)


ELSEWHERE = """
import faulthandler, mmap, os, sys
from pc2scan.files._map import Map
with open(sys.argv[1], "rb+") as file:
    mapped = Map(file.fileno(), 4096)
    if sys.argv[2:]:
        faulthandler.enable()
    mapped.fetch(0, 1)
    other = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    os.ftruncate(file.fileno(), 0)
    print(memoryview(mapped)[0], flush=True)
    print(other[0])
"""


@pytest.mark.parametrize(
    ("options", "later"),
    [([], []), (["-X", "faulthandler"], []), ([], ["later"])],
    ids=["no handler", "a handler from before", "a handler that hands back what it is given"],
)
def test_other_maps_are_none_of_its_business(options: list[str], later: list[str], file: Any) -> None:
    done = subprocess.run(
        [sys.executable, *options, "-c", ELSEWHERE, file.name, *later],
        timeout=60,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CORE, (0, 0)),
    )
    assert (done.returncode, done.stdout) == (-signal.SIGBUS, "0\n")
    assert ("Fatal Python error: Bus error" in done.stderr) is bool(options or later)


def test_a_handler_that_came_later_does_not_stay_alone(file: Any) -> None:
    before = signal.getsignal(signal.SIGBUS)
    mapped = _map.Map(file.fileno(), len(DATA))
    told: list[int] = []
    try:
        signal.signal(signal.SIGBUS, lambda number, _: told.append(number))
        mapped.fetch(0, 1)
        os.ftruncate(file.fileno(), 0)
        assert memoryview(mapped)[0] == 0
        assert told == []
        # Sent by a process: that is for the other one.
        os.kill(os.getpid(), signal.SIGBUS)
        assert told == [signal.SIGBUS]
    finally:
        signal.signal(signal.SIGBUS, before)
