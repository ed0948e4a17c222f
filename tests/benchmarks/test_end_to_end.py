"""Whole conversions. Run it with ``pytest -n 0 -m benchmark tests/benchmarks/test_end_to_end.py``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

import pc2scan
from benchmarks.clouds import CLOUD_BYTES, FORMS, POINTS, TRIFLE, write_recording

if TYPE_CHECKING:
    from pathlib import Path

    from pytest_benchmark.fixture import BenchmarkFixture

CLOUDS = 32
PARAMS = pc2scan.ProjectionParams(min_height=-0.5, max_height=1.0)


@pytest.fixture(scope="module", params=FORMS)
def source(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recording(tmp_path_factory.mktemp("clouds"), FORMS[request.param], CLOUDS * CLOUD_BYTES)


@pytest.mark.benchmark
@pytest.mark.parametrize("jobs", [1, 2])
def test_converting(benchmark: BenchmarkFixture, source: Path, jobs: int, tmp_path: Path) -> None:
    benchmark.group = f"converting {source.name}"
    benchmark.extra_info["bytes"] = CLOUDS * CLOUD_BYTES

    def convert() -> pc2scan.Report:
        return pc2scan.convert(
            source, tmp_path / "scans.mcap", params=PARAMS, topics=[POINTS], only_scans=True, jobs=jobs, overwrite=True
        )

    assert benchmark(convert).topics[0].messages_out == CLOUDS


@pytest.mark.benchmark
@pytest.mark.parametrize("outputs", [1, 4])
def test_several_outputs(benchmark: BenchmarkFixture, source: Path, outputs: int, tmp_path: Path) -> None:
    benchmark.group = f"outputs of {source.name}"
    scans = {f"/scan{n}": {"sources": POINTS, "beams": 360 + 120 * n} for n in range(outputs)}

    def convert() -> pc2scan.Report:
        path = tmp_path / "scans.mcap"
        return pc2scan.convert(
            source, path, scans=scans, only_scans=True, jobs=2, overwrite=True, min_height=-0.5, max_height=1.0
        )

    report = benchmark(convert)
    assert [topic.messages_out for topic in report.topics if topic.spec is not None] == [CLOUDS] * outputs


@pytest.mark.benchmark
def test_passing(benchmark: BenchmarkFixture, source: Path, tmp_path: Path) -> None:
    benchmark.group = f"passing {source.name}"
    benchmark.extra_info["bytes"] = CLOUDS * CLOUD_BYTES
    destination = tmp_path / f"passed{source.suffix}"

    def convert() -> pc2scan.Report:
        return pc2scan.convert(
            source,
            destination,
            params=PARAMS,
            topics=[TRIFLE],
            storage="sqlite3" if source.is_dir() else None,
            compression="none",
            overwrite=True,
        )

    counts = {topic.topic: topic.messages_out for topic in benchmark(convert).topics}
    assert counts == {POINTS: CLOUDS, TRIFLE: 1}
