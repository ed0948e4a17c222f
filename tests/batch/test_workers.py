"""Worker processes: jobs in, events out, and what cannot be sent."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from batch.datasets import HEIGHTS
from pc2scan.batch.frames import receive, send
from pc2scan.batch.request import request_of
from pc2scan.batch.resources import available_bytes, workers_for
from pc2scan.batch.work import Job, convert_one
from pc2scan.batch.workers import Began, Ended, Progressed, execute
from pc2scan.errors import Pc2ScanError
from support.builders import CONTENT, write_rosbag1

if TYPE_CHECKING:
    from pathlib import Path


def job_of(source: Path, out: Path, **words: object) -> Job:
    request = request_of({"min_height": float(HEIGHTS[1]), "max_height": float(HEIGHTS[3]), **words})
    destination = str(out / f"{source.stem}_scan.bag")
    size = source.stat().st_size if source.exists() else 0
    return Job(key=source.name, sources=(str(source),), destination=destination, request=request, size_bytes=size)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_rosbag1(tmp_path / "a.bag", CONTENT)


def test_jobs_become_results_in_another_process_as_in_this_one(bag: Path, tmp_path: Path) -> None:
    missing = tmp_path / "missing.bag"
    other = write_rosbag1(tmp_path / "b.bag", CONTENT)
    jobs = [job_of(path, tmp_path) for path in (bag, missing, other)]
    events = list(execute(jobs, workers=2, cores=2))
    results = {event.result.key: event.result for event in events if isinstance(event, Ended)}
    assert {key: (result.outcome, result.attempts) for key, result in results.items()} == {
        "a.bag": ("converted", 1),
        "missing.bag": ("failed", 1),
        "b.bag": ("converted", 1),
    }
    assert {event.key for event in events if isinstance(event, Began)} == set(results)
    assert all(0 <= event.done <= event.total for event in events if isinstance(event, Progressed))
    assert results["missing.bag"].error is not None
    assert results["missing.bag"].error["class"] == "MissingError"
    here = tmp_path / "here"
    here.mkdir()
    same = convert_one(job_of(bag, here))
    assert (here / "a_scan.bag").read_bytes() == (tmp_path / "a_scan.bag").read_bytes()
    assert same.output_identity.size_bytes == results["a.bag"].output_identity.size_bytes


def test_a_bug_is_the_result_of_its_recording(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("pc2scan.batch.work.run", fails)
    result = convert_one(job_of(bag, tmp_path))
    assert (result.outcome, result.exit_status) == ("failed", 1)
    assert result.error is not None
    assert result.error["message"] == "ZeroDivisionError: oh"
    assert "in fails" in result.error["traceback"]


@dataclass(frozen=True)
class OfThisTest:
    """A filter that no other process can import."""

    name = "of_this_test"
    explanation = "nothing"
    fields = ()
    frame = "odom"


def test_what_cannot_be_sent_is_told(bag: Path, tmp_path: Path) -> None:
    here = OfThisTest()
    OfThisTest.__module__ = "no_such_module_anywhere"
    import sys
    import types

    module = types.ModuleType("no_such_module_anywhere")
    module.OfThisTest = OfThisTest  # type: ignore[attr-defined]
    sys.modules[module.__name__] = module
    try:
        with pytest.raises(Pc2ScanError, match="cannot be sent to another process") as raised:
            list(execute([job_of(bag, tmp_path, filters=[here])], workers=1, cores=1))
    finally:
        del sys.modules[module.__name__]
    assert "that can be imported" in (raised.value.hint or "")
    local = type("Local", (OfThisTest,), {})()
    with pytest.raises(Pc2ScanError, match="cannot be sent to another process"):
        list(execute([job_of(bag, tmp_path, filters=[local])], workers=1, cores=1))


def test_frames() -> None:
    stream = io.BytesIO()
    send(stream, {"a": 1})
    send(stream, None)
    whole = stream.getvalue()
    stream.seek(0)
    assert (receive(stream), receive(stream)) == ({"a": 1}, None)
    for cut in (0, 5, 9, len(whole) - 1):
        short = io.BytesIO(whole[:cut])
        with pytest.raises(EOFError):
            receive(short), receive(short)


def test_how_many_at_a_time() -> None:
    assert workers_for(1000, 8, 64_000_000_000) == 8
    assert workers_for(3, 8, 64_000_000_000) == 3
    assert workers_for(1000, 8, 1_000_000_000) == 3
    assert workers_for(1000, 8, 10) == 1
    assert workers_for(1000, 8, None) == 8
    assert workers_for(0, 8, None) == 1
    found = available_bytes()
    assert found is None or found > 1_000_000
