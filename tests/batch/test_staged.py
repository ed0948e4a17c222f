"""Jobs at URLs: what is copied ahead of the workers, and how much room it takes."""

from __future__ import annotations

import time
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.batch.identity import Identity
from pc2scan.batch.request import request_of
from pc2scan.batch.staged import jobs_here
from pc2scan.batch.work import Job, Result
from pc2scan.batch.workers import Ended, Queue

if TYPE_CHECKING:
    from collections.abc import Iterator

fsspec = pytest.importorskip("fsspec")

SIZE = 2_000_000


@pytest.fixture
def store() -> Iterator[Any]:
    fs = fsspec.filesystem("memory")
    for number in range(4):
        fs.pipe_file(f"/in/{number}.bag", bytes(SIZE))
    yield fs
    fs.rm("/", recursive=True)


def jobs(scratch: Path, out: str, most: int | None = None) -> list[Job]:
    request = request_of({})
    return [
        Job(
            key=f"{number}.bag",
            sources=(f"memory://in/{number}.bag",),
            destination=f"{out}/{number}_scan.bag",
            request=request,
            size_bytes=SIZE,
            scratch=str(scratch),
            scratch_size=most,
        )
        for number in range(4)
    ]


def copies(scratch: Path) -> int:
    return len(list(scratch.rglob("*.bag")))


def taken(queue: Queue) -> Job:
    deadline = time.monotonic() + 20
    while (job := queue.take()) is None:
        assert time.monotonic() < deadline
        time.sleep(0.002)
    return job


def wait_for(scratch: Path, count: int) -> None:
    deadline = time.monotonic() + 20
    while copies(scratch) != count:
        assert time.monotonic() < deadline, copies(scratch)
        time.sleep(0.002)


def ended(job: Job) -> Result:
    return Result(key=job.key, outcome="converted", exit_status=0, output_identity=Identity((("x", 1, 1),)))


@pytest.mark.usefixtures("store")
def test_the_next_one_is_copied_while_one_is_converted(tmp_path: Path) -> None:
    with jobs_here(jobs(tmp_path, "/out"), workers=1) as queue:
        queue.begin(lambda _event: None)
        first = taken(queue)
        assert Path(first.sources[0]).stat().st_size == SIZE
        # One that is converted, and one that is next.
        wait_for(tmp_path, 2)
        time.sleep(0.05)
        assert copies(tmp_path) == 2
        assert queue.done(ended(first)) is not None
        assert not Path(first.sources[0]).exists()
        taken(queue)
        wait_for(tmp_path, 2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("store")
def test_recordings_wait_until_there_is_space_for_their_copies(tmp_path: Path) -> None:
    with jobs_here(jobs(tmp_path, "/out", most=SIZE + SIZE // 2), workers=2) as queue:
        queue.begin(lambda _event: None)
        for number in range(4):
            job = taken(queue)
            assert job.key == f"{number}.bag"
            time.sleep(0.02)
            assert copies(tmp_path) == 1
            assert queue.take() is None
            queue.done(ended(job))
        assert not queue.is_open


def test_results_are_uploaded_while_the_next_is_converted(store: Any, tmp_path: Path) -> None:
    events: SimpleQueue[Any] = SimpleQueue()
    with jobs_here(jobs(tmp_path, "memory://out", most=2 * (2 * SIZE + 1_000_000)), workers=1) as queue:
        queue.begin(events.put)
        for _ in range(4):
            job = taken(queue)
            assert job.room is not None
            assert job.room[1] == 2 * SIZE + 1_000_000
            Path(job.destination).write_bytes(b"scans")
            assert queue.done(ended(job)) is None
        found = [event.result for event in (events.get(timeout=20) for _ in range(8)) if isinstance(event, Ended)]
    assert [result.output_identity.size_bytes for result in found] == [5] * 4
    assert len(store.find("/out")) == 4
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("store")
def test_a_result_that_is_too_large_is_tried_again_with_all_the_room(tmp_path: Path) -> None:
    most = 4 * SIZE + 2_000_000
    with jobs_here(jobs(tmp_path, "memory://out", most=most)[:2], workers=1) as queue:
        queue.begin(lambda _event: None)
        job, other = taken(queue), taken(queue)
        assert queue.done(Result(key=job.key, outcome="failed", exit_status=1, error={"class": "ScratchError"})) is None
        time.sleep(0.05)
        # All the room: when the other one has ended.
        assert queue.take() is None
        assert queue.done(Result(key=other.key, outcome="failed", exit_status=1, error={"class": "Other"})) is not None
        again = taken(queue)
        assert (again.key, again.room and again.room[1]) == (job.key, most)
        assert queue.done(Result(key=job.key, outcome="failed", exit_status=1, error={"class": "ScratchError"}))
        assert not queue.is_open
