"""Which clouds are judged at the beginning of a conversion."""

from __future__ import annotations

from itertools import permutations
from typing import TYPE_CHECKING

from benchmarks.clouds import FORMS, write_recording
from pc2scan.core.params import ProjectionParams
from pc2scan.pipeline.first_clouds import FirstClouds, TopicClouds
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.report import Report
from pc2scan.pipeline.run import OutputOptions, run
from pc2scan.pipeline.scan_spec import ScanSpec

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from pc2scan.core.points import Points
    from pc2scan.pipeline.first_clouds import Sampled
    from pc2scan.tf.placing import Placement


def test_the_first_clouds_pass_in_whatever_order_threads_convert_them() -> None:
    times = [10, 10, 20, 20, 30, 40]
    for order in permutations(range(len(times))):
        clouds = FirstClouds(Report([], "", ()), None, lambda: None).of(ScanSpec(), "/points")
        passed = {number for number in order if clouds.may_be_first(times[number])}
        # Equal times are written in the order of the file, so that either of 20 may be the third.
        assert passed >= {0, 1, 2, 3}


def test_few_of_many_small_clouds_are_sampled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_recording(tmp_path, FORMS["MCAP, none"], 16 << 20, points=1_000)
    sampled = []
    take = TopicClouds.sample

    def counted(self: TopicClouds, points: Points, place: Placement) -> Sampled:
        sampled.append(points.stamp_ns)
        return take(self, points, place)

    monkeypatch.setattr(TopicClouds, "sample", counted)
    options = ConvertOptions(scans=(ScanSpec(params=ProjectionParams(min_height=-0.5)),), jobs=2)
    report = run([source], tmp_path / "scans.mcap", options, OutputOptions())
    assert report.messages_read > 500
    # Three are judged; a thread may take some before another one has taken earlier ones.
    assert 1 <= len(sampled) <= 20
