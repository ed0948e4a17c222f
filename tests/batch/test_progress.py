"""The progress of a batch: recordings count by their work as soon as it is known, before that by their bytes."""

from __future__ import annotations

import os
from collections import Counter
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest

import pc2scan
from pc2scan.batch.jobs import Event, convert_one
from pc2scan.cli.time_left import TimeLeft
from support.batches import KEYWORDS, place

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

STEPS = 50


@pytest.mark.parametrize(
    ("works", "totals", "known_from"),
    [
        # As much work for each byte: known as soon as one has begun.
        ([900] * 4, [900 * 4] * 4, 0),
        # The first ones take three times as long as the others; known when the first of these has begun, nearly.
        ([900, 900, 300, 300], [3600, 3600, 2800, 2400], 2),
        # Over before they say it.
        ([0] * 4, [None] * 4, 3),
    ],
)
def test_the_time_left_of_a_batch(works: list[int], totals: list[int | None], known_from: int, tmp_path: Path) -> None:
    drives = place(tmp_path / "drives", *(f"{name}.bag" for name in "abcd"))
    size = (drives / "a.bag").stat().st_size
    now = 0.0
    begun: list[str] = []
    seen: list[Any] = []

    def execute(jobs: Any, **_: object) -> Iterator[Event]:
        nonlocal now
        for job, work in zip(jobs, works, strict=True):
            begun.append(job.key)
            yield Event("begun", job.key)
            for step in range(STEPS + 1):
                yield Event("progress", job.key, (work * step // STEPS, work))
                now += (work or size) / STEPS
            yield Event("done", job.key, convert_one(job))

    with patch("pc2scan.batch.run.run_jobs", execute):
        pc2scan.batch(
            drives,
            tmp_path / "out",
            jobs=1,
            progress=lambda step: seen.append((len(begun) - 1, now, step)),
            **KEYWORDS,
        )
    assert [step.recordings_done for _, _, step in seen][-1] == 4
    left = TimeLeft()
    for running, moment, step in seen:
        told = left.seconds(step.work_done, step.work_total, moment)
        # Not where a recording has begun, and has not said yet how much work it is.
        if step.work_done > sum(works[:running]):
            assert step.work_total == pytest.approx(totals[running] or 4 * size, abs=2)
            if told is not None and running > known_from and moment > now / 10:
                assert moment + told == pytest.approx(now, rel=0.1)
    assert seen[-1][2].work_done == seen[-1][2].work_total


@pytest.mark.parametrize(
    ("lengths", "workers"),
    [
        ([1, 1, 1], 2),
        ([6, 1, 1, 1], 2),
        ([4, 3, 2, 1], 3),
        ([1] * 9, 4),
        ([8, *[1] * 20], 4),
    ],
)
def test_the_time_left_counts_workers_that_become_idle(lengths: list[int], workers: int, tmp_path: Path) -> None:
    drives = place(tmp_path / "drives", *(f"{number:02}.bag" for number in range(len(lengths))))
    size = 2 * (drives / "00.bag").stat().st_size
    for path, length in zip(sorted(drives.iterdir()), lengths, strict=True):
        os.truncate(path, size * length)
    now = 0
    seen: list[Any] = []

    def execute(jobs: Any, **_: object) -> Iterator[Event]:
        """Convert so many at a time, each at the same speed, in steps of a tenth of the shortest."""
        nonlocal now
        waiting, running = list(jobs), list[Any]()
        done: Counter[str] = Counter()
        while waiting or running:
            while waiting and len(running) < workers:
                running.append(waiting.pop(0))
                yield Event("begun", running[-1].key)
            now += 1
            for job in running:
                done[job.key] += 1
                yield Event("progress", job.key, (done[job.key], job.size_bytes // size * 10))
            for job in [job for job in running if done[job.key] == job.size_bytes // size * 10]:
                running.remove(job)
                yield Event("done", job.key, convert_one(job))

    with patch("pc2scan.batch.run.run_jobs", execute):
        pc2scan.batch(
            drives, tmp_path / "out", jobs=workers, progress=lambda step: seen.append((now, step)), **KEYWORDS
        )
    left = TimeLeft()
    last = dict(seen)
    for moment, step in last.items():
        told = left.seconds(step.work_done, step.work_total, moment)
        if told is not None and moment > now / 10:
            assert moment + told == pytest.approx(now, rel=0.03)
    assert last[now].work_done == last[now].work_total == now * workers


def test_a_recording_that_is_tried_again_begins_again(tmp_path: Path) -> None:
    drives = place(tmp_path / "drives", "a.bag", "b.bag")
    seen: list[Any] = []

    def execute(jobs: Any, **_: object) -> Iterator[Event]:
        first, second = jobs
        yield Event("begun", first.key)
        yield Event("progress", first.key, (60, 100))
        yield Event("died", first.key, "killed")
        yield Event("begun", first.key)
        yield Event("progress", first.key, (10, 100))
        for job in (first, second):
            yield Event("done", job.key, convert_one(job))

    with patch("pc2scan.batch.run.run_jobs", execute):
        pc2scan.batch(drives, tmp_path / "out", jobs=1, progress=seen.append, **KEYWORDS)
    assert [(step.work_done, step.work_total) for step in seen[1:]] == [
        (60, 200),
        (0, seen[0].work_total),
        (0, seen[0].work_total),
        (10, 200),
        (100, 200),
        (200, 200),
    ]
