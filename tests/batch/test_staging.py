"""Jobs at URLs: what is copied ahead of the workers, and how much room it takes."""

from __future__ import annotations

import time
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.batch.identity import Identity
from pc2scan.batch.jobs import Job, JobResult
from pc2scan.batch.processes import JobEnd
from pc2scan.batch.request import request_of
from pc2scan.batch.staging import staged_jobs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

fsspec = pytest.importorskip("fsspec")

SIZE = 2_000_000


@pytest.fixture(autouse=True)
def store() -> Iterator[Any]:
    fs = fsspec.filesystem("memory")
    for number in range(4):
        fs.pipe_file(f"/in/{number}.bag", bytes(SIZE))
    yield fs
    fs.rm("/", recursive=True)


def jobs(scratch: Path, out: str, most: int | None = None) -> list[Job]:
    common: dict[str, Any] = {"request": request_of({}), "size_bytes": SIZE, "scratch": str(scratch)}
    return [
        Job(
            key=f"{number}.bag",
            sources=(f"memory://in/{number}.bag",),
            destination=f"{out}/{number}_scan.bag",
            scratch_size=most,
            **common,
        )
        for number in range(4)
    ]


def copies(scratch: Path) -> int:
    return len(list(scratch.rglob("*.bag")))


def until(condition: Callable[[], Any]) -> Any:
    """Wait until something is there, and return it."""
    deadline = time.monotonic() + 60
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.002)
    return found


def ended(job: Job, error: str = "") -> JobResult:
    if error:
        return JobResult(key=job.key, outcome="failed", exit_status=1, error={"kind": error})
    return JobResult(key=job.key, outcome="converted", exit_status=0, output_identity=Identity((("x", 1, 1),)))


def test_the_next_one_is_copied_while_one_is_converted(tmp_path: Path) -> None:
    with staged_jobs(jobs(tmp_path, "/out"), workers=1) as queue:
        queue.begin(lambda _event: None)
        first = until(queue.take)
        assert Path(first.sources[0]).stat().st_size == SIZE
        # One that is converted, and one that is next.
        until(lambda: copies(tmp_path) == 2)
        time.sleep(0.05)
        assert copies(tmp_path) == 2
        assert queue.done(ended(first)) is not None
        assert not Path(first.sources[0]).exists()
        until(queue.take)
        until(lambda: copies(tmp_path) == 2)
    assert list(tmp_path.iterdir()) == []


def test_recordings_wait_until_there_is_space_for_their_copies(tmp_path: Path) -> None:
    with staged_jobs(jobs(tmp_path, "/out", most=SIZE + SIZE // 2), workers=2) as queue:
        queue.begin(lambda _event: None)
        for number in range(4):
            job = until(queue.take)
            assert job.key == f"{number}.bag"
            time.sleep(0.02)
            assert copies(tmp_path) == 1
            assert queue.take() is None
            queue.done(ended(job))
        assert not queue.is_open


def test_results_are_uploaded_while_the_next_is_converted(store: Any, tmp_path: Path) -> None:
    events: SimpleQueue[Any] = SimpleQueue()
    with staged_jobs(jobs(tmp_path, "memory://out", most=2 * (2 * SIZE + 1_000_000)), workers=1) as queue:
        queue.begin(events.put)
        for _ in range(4):
            job = until(queue.take)
            assert job.room[1] == 2 * SIZE + 1_000_000
            Path(job.destination).write_bytes(b"scans")
            assert queue.done(ended(job)) is None
        found = [event.result for event in (events.get(timeout=60) for _ in range(8)) if isinstance(event, JobEnd)]
    assert [result.output_identity.size_bytes for result in found] == [5] * 4
    assert len(store.find("/out")) == 4
    assert list(tmp_path.iterdir()) == []


def test_a_result_that_is_too_large_gets_all_the_room(tmp_path: Path) -> None:
    most = 4 * SIZE + 2_000_000
    with staged_jobs(jobs(tmp_path, "memory://out", most=most)[:2], workers=1) as queue:
        queue.begin(lambda _event: None)
        job, other = until(queue.take), until(queue.take)
        assert queue.done(ended(job, "ScratchError")) is None
        time.sleep(0.05)
        # All the room: when the other one has ended.
        assert queue.take() is None
        assert queue.done(ended(other, "Other")) is not None
        again = until(queue.take)
        assert (again.key, again.room and again.room[1]) == (job.key, most)
        assert queue.done(ended(job, "ScratchError"))
        assert not queue.is_open
