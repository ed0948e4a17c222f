"""What becomes of each topic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pc2scan.conversion.plan import Plan, make_plan
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import TopicError
from pc2scan.model import Connection
from pc2scan.request.spec import Combining, Request, ScanSpec, TopicRequest
from support.tables import rows

TABLES = Path(__file__).with_name("plans.txt")
CLOUD, SCAN = "sensor_msgs/PointCloud2", "sensor_msgs/LaserScan"
KINDS = {"cloud": CLOUD, "imu": "sensor_msgs/msg/Imu", "scan": SCAN}
BASE: dict[str, Any] = {"params": ProjectionParams(target_frame="base_link")}


def plan(topics: dict[str, str], requests: str = "", **options: Any) -> Plan:
    connections = [Connection(i, each, KINDS.get(kind, kind), "ros1") for i, (each, kind) in enumerate(topics.items())]
    own = {name: options.pop(name) for name in ("params", "reverse") if name in options}
    combining = Combining.of({name: options.pop(name) for name in ("rebin",) if name in options})
    scan = ScanSpec(topics=tuple(map(TopicRequest.parse, requests.split())), combining=combining, **own)
    return make_plan(connections, Request(scans=(scan,), **options))


@pytest.mark.parametrize(("topics", "requests", "options", "targets", "passing"), rows(TABLES, "targets"))
def test_topics_become_scans_pass_or_are_left_out(
    topics: dict[str, str], requests: str, options: dict[str, Any], targets: list[str], passing: str
) -> None:
    made = plan(topics, requests, **options)
    assert [route.targets for route in made.routes] == [tuple(each.split()) for each in targets]
    assert [route.connection.topic for route in made.routes if route.passes] == passing.split()


@pytest.mark.parametrize(("options", "warnings"), rows(TABLES, "warnings"))
def test_patterns_without_effect_draw_a_warning(options: dict[str, Any], warnings: list[str]) -> None:
    found = plan({"/points": "cloud", "/pose": "imu", "/tf": "imu"}, **options).warnings
    assert [text[: len(start)] for text, start in zip(found, warnings, strict=True)] == warnings


@pytest.mark.parametrize(("topics", "requests", "words"), rows(TABLES, "requests that cannot be met"))
def test_requests_that_cannot_be_met(topics: dict[str, str], requests: str, words: list[str]) -> None:
    with pytest.raises(TopicError) as caught:
        plan(topics, requests)
    told = f"{caught.value} {caught.value.hint}"
    assert all(word in told for word in words), told


def test_topics_that_share_a_target_become_one_scan() -> None:
    topics = {"/a": "cloud", "/b": "cloud", "/c": "scan", "/d": "cloud"}
    made = plan(topics, "/b:=/s /a:=/s /c:=/s /d /a:=/alone", **BASE)
    together = ("/s", ("/b", "/a", "/c"))
    assert [[(each.target, each.sources) for each in route.outputs] for route in made.routes] == [
        [("/alone", ()), together],
        [together],
        [together],
        [("/d/scan", ())],
    ]
    # A glob may name them.
    made = plan({"/l_1": "cloud", "/l_2": "cloud", "/imu": "imu"}, "/l_*:=/s", **BASE)
    assert {each.sources for route in made.routes for each in route.outputs} == {("/l_1", "/l_2")}
    with pytest.raises(TopicError, match="both become /c"):
        plan({"/a": "scan", "/b": "scan"}, "/a:=/c /b:=/c", reverse=True)


def test_an_output_without_sources_has_the_only_topic() -> None:
    spec = ScanSpec(name="/low", place="scans.yaml, line 3")
    options = Request(scans=(spec, ScanSpec(name="/high", topics=(TopicRequest("/a", "/high"),))))
    (route,) = make_plan([Connection(1, "/a", CLOUD, "ros1")], options).routes
    assert [(each.spec.name, each.target) for each in route.outputs] == [("/low", "/low"), ("/high", "/high")]
    two = [Connection(i, topic, CLOUD, "ros1") for i, topic in enumerate(("/a", "/b"))]
    with pytest.raises(TopicError, match=r"scans.yaml, line 3, /low: it has no 'sources', and the recording has sev"):
        make_plan(two, options)
