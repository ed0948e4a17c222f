"""Several outputs of one conversion: each as if it were alone."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from pc2scan.bags.opening import open_recording
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import TopicError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.pointcloud2 import POINTCLOUD2
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.run import OutputOptions, run
from pc2scan.pipeline.scan_spec import ScanSpec, TopicRequest
from pc2scan.pipeline.stages.where import Where
from pc2scan.tf.options import FrameOptions
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.mcap"
MOUNT = FrameOptions()


def spec(target: str, *, filters: Any = (), deskew: dict[str, Any] | None = None, **params: Any) -> ScanSpec:
    return ScanSpec(
        name=target,
        place="here",
        topics=(TopicRequest("/points", target),),
        params=ProjectionParams(**{"min_height": -0.3, "max_height": 1.0, **params}),
        filters=tuple(filters),
        **(deskew or {}),
    )


def messages(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with closing(open_recording(path)) as reader:
        for message in reader.messages():
            found.setdefault(message.connection.topic, []).append((message.log_time_ns, bytes(message.data)))
    return found


def converted(path: Path, *specs: ScanSpec, frames: FrameOptions = MOUNT, **options: Any) -> Any:
    asked = ConvertOptions(scans=specs, frames=frames, only_scans=True, **options)
    return run([HALL], path, asked, OutputOptions(overwrite=True))


def made(report: Any) -> list[Any]:
    """The entries of the outputs."""
    return [topic for topic in report.topics if topic.action == "converted"]


SPECS = (
    spec("/low", max_height=0.2),
    spec("/base", target_frame="base_link", geometry="centered", beams=720),
    spec("/base_far", target_frame="base_link", range_min=2.0, reduce="median", intensity_field="intensity"),
    spec("/bright", filters=[Where("intensity > 20")], target_frame="base_link", scan_time="auto"),
)


@pytest.mark.parametrize("jobs", [1, 3])
def test_each_output_is_as_if_it_were_alone(jobs: int, tmp_path: Path) -> None:
    together = converted(tmp_path / "all.mcap", *SPECS, jobs=jobs)
    found = messages(tmp_path / "all.mcap")
    assert list(found) == [each.name for each in SPECS]
    for each, entry in zip(SPECS, made(together), strict=True):
        (own,) = made(converted(tmp_path / "one.mcap", each, jobs=jobs))
        assert messages(tmp_path / "one.mcap") == {each.name: found[each.name]}
        assert entry == own
        assert entry.messages_out


def test_a_message_is_decoded_and_placed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pc2scan.pipeline.stages.place import Place
    from pc2scan.pipeline.stages.select import Select

    calls: Counter[str] = Counter()
    decoder = CLOUDS[POINTCLOUD2]

    def counting(serialization: str) -> Any:
        decode = decoder(serialization)

        def counted(data: Any) -> Any:
            calls["decode"] += 1
            return decode(data)

        return counted

    def counted(kind: type[Any], name: str) -> None:
        work = kind.__call__

        def call(self: Any, value: Any) -> Any:
            calls[name] += 1
            return work(self, value)

        monkeypatch.setattr(kind, "__call__", call)

    monkeypatch.setitem(CLOUDS, POINTCLOUD2, counting)
    counted(Place, "place")
    counted(Select, "select")
    bright = [Where("intensity > 20")]
    specs = [spec(f"/{n}", target_frame="base_link", range_min=n, filters=bright) for n in range(3)]
    report = converted(tmp_path / "all.mcap", *specs, spec("/own"), spec("/own_near", range_max=5.0))
    count = made(report)[0].messages_out
    first = calls["decode"] - count
    # The first cloud is looked at beforehand for the field of each output.
    assert first == 3
    assert calls == {"decode": count + first, "place": 2 * count, "select": count}


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_is_that_of_one_output(jobs: int, tmp_path: Path) -> None:
    report = converted(tmp_path / "a.mcap", spec("/lost", target_frame="nowhere"), spec("/found"), jobs=jobs)
    lost, found = made(report)
    count = found.messages_out
    assert (lost.messages_in, lost.messages_out, lost.skipped) == (count, 0, count)
    assert (found.messages_in, found.skipped, found.points.total > 0) == (count, 0, True)
    assert report.exit_status == 3
    assert list(messages(tmp_path / "a.mcap")) == ["/found"]
    assert any("nowhere" in entry.reason for entry in report.skipped)
    assert {entry.targets for entry in report.skipped} == {("/lost",)}


def test_nothing_is_written_if_no_output_can_be_made(tmp_path: Path) -> None:
    with pytest.raises(pc2scan.errors.TransformError, match="nothing can be converted"):
        converted(tmp_path / "a.mcap", spec("/lost", target_frame="nowhere"), spec("/found", target_frame="never"))
    assert list(tmp_path.iterdir()) == []


def test_warnings_and_counts_are_those_of_each_output(tmp_path: Path) -> None:
    report = converted(tmp_path / "a.mcap", spec("/scan"), spec("/none", min_height=90.0, max_height=91.0))
    full, empty = made(report)
    assert (full.empty_scans, empty.empty_scans) == (0, empty.messages_out)
    assert empty.points.height > full.points.height
    (warning,) = [text for text in report.warnings if "have no return" in text]
    assert warning.startswith(
        f"{empty.messages_out} of {empty.messages_out} scans on /none have no return at all: 97% "
    )
    assert report.exit_status == 0


def test_two_outputs_cannot_have_one_topic(tmp_path: Path) -> None:
    twice = (spec("/scan"), spec("/scan", range_max=5.0))
    with pytest.raises(TopicError, match=r"/scan \(here\) and /scan \(here\) would both become /scan"):
        converted(tmp_path / "a.mcap", *twice)


def test_a_dry_run_looks_at_each_output(tmp_path: Path) -> None:
    asked = ConvertOptions(scans=(*SPECS, spec("/lost", target_frame="nowhere")), frames=MOUNT)
    report = run([HALL], tmp_path / "a.mcap", asked, OutputOptions(dry_run=True))
    *others, lost = made(report)
    assert all(entry.points.used for entry in others)
    assert (lost.target, lost.points.total) == ("/lost", 0)
    assert list(tmp_path.iterdir()) == []
