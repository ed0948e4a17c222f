"""What becomes of each topic."""

from __future__ import annotations

from typing import Any

import pytest

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import TopicError
from pc2scan.model import Connection
from pc2scan.pipeline.combine.asked import Combining
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.plan import Plan, make_plan
from pc2scan.pipeline.scan_spec import ScanSpec, TopicRequest

CLOUD, IMU, SCAN = "sensor_msgs/PointCloud2", "sensor_msgs/msg/Imu", "sensor_msgs/LaserScan"
ONE = {"/points": CLOUD, "/imu": IMU}
CAMERAS = {"/points": CLOUD, "/cam/left": IMU, "/cam/right": IMU, "/imu": IMU}
REBIN = {"combining": Combining.of(rebin=True)}
BASE: dict[str, Any] = {"params": ProjectionParams(target_frame="base_link")}


def plan(topics: dict[str, str], *requests: str, **options: Any) -> Plan:
    connections = [Connection(i, topic, kind, "ros1") for i, (topic, kind) in enumerate(topics.items())]
    own = {name: options.pop(name) for name in ("params", "combining", "reverse") if name in options}
    scan = ScanSpec(topics=tuple(map(TopicRequest.parse, requests)), **own)
    return make_plan(connections, ConvertOptions(scans=(scan,), **options))


@pytest.mark.parametrize(
    ("topics", "requests", "options", "targets", "passing"),
    [
        (ONE, "", {}, ["/scan", None], "/imu"),
        ({"/p": "sensor_msgs/msg/PointCloud2"}, "", {}, ["/scan"], ""),
        # Several clouds become a scan each.
        ({"/a/points": CLOUD, "/b/points/": CLOUD}, "", {}, ["/a/points/scan", "/b/points/scan"], ""),
        ({"/a": CLOUD, "/b": CLOUD}, "/a:=/front_scan", {}, ["/front_scan", None], "/b"),
        (ONE, "/points:=/a points:=/b /points:=/a", {}, [("/a", "/b"), None], "/imu"),
        (ONE, "/points /points:=/b", {}, [("/scan", "/b"), None], "/imu"),
        # A leading slash is no difference.
        ({"points": CLOUD}, "/points", {}, ["/scan"], ""),
        ({"/points": CLOUD}, "points", {}, ["/scan"], ""),
        # What passes.
        (ONE, "", {"keep_clouds": True}, ["/scan", None], "/points /imu"),
        (ONE, "", {"only_scans": True}, ["/scan", None], ""),
        (CAMERAS, "", {"keep": ("/cam/*",)}, ["/scan", None, None, None], "/cam/left /cam/right"),
        (CAMERAS, "", {"drop": ("cam/*",)}, ["/scan", None, None, None], "/imu"),
        (CAMERAS, "", {"keep": ("/cam/*",), "drop": ("/cam/left",)}, ["/scan", None, None, None], "/cam/right"),
        # A dropped cloud is not converted unless it is named; a taken topic is free once it is dropped.
        ({"/a": CLOUD, "/b": CLOUD}, "", {"drop": ("/b",)}, ["/scan", None], ""),
        ({"/a": CLOUD, "/b": CLOUD}, "/b", {"drop": ("/b",)}, [None, "/scan"], "/a"),
        ({"/points": CLOUD, "/scan": SCAN}, "", {"drop": ("/scan",)}, ["/scan", None], ""),
        ({"/points": CLOUD, "/scan": SCAN}, "", {"only_scans": True}, ["/scan", None], ""),
        # Scans that are rebinned keep their topic unless they are written too.
        ({"/scan": SCAN, "/points": CLOUD}, "", REBIN, ["/scan", None], "/points"),
        ({"/scan": SCAN}, "", {**REBIN, "keep_clouds": True}, ["/scan_rebinned"], "/scan"),
    ],
)
def test_topics_become_scans_pass_or_are_left_out(
    topics: dict[str, str], requests: str, options: dict[str, Any], targets: list[Any], passing: str
) -> None:
    made = plan(topics, *requests.split(), **options)
    expected = [each if isinstance(each, tuple) else (each,) if each else () for each in targets]
    assert [route.targets for route in made.routes] == expected
    assert [route.connection.topic for route in made.routes if route.passes] == passing.split()


@pytest.mark.parametrize(
    ("options", "warnings"),
    [
        ({"drop": ("/camera/*",), "keep": ("/p*",)}, ["`drop=/camera/*` matches no topic"]),
        (
            {"drop": ("/TF",), "keep": ("/tff",)},
            [f"`{option}` matches no topic; did you mean /tf?" for option in ("keep=/tff", "drop=/TF")],
        ),
        (
            {"keep": ("/points",)},
            ["`keep=/points` matches only topics that are converted, and has no effect on them; "],
        ),
        ({"keep": ("/points",), "keep_clouds": True}, []),
    ],
)
def test_patterns_without_effect_draw_a_warning(options: dict[str, Any], warnings: list[str]) -> None:
    found = plan({"/points": CLOUD, "/pose": IMU, "/tf": IMU}, **options).warnings
    assert [text[: len(start)] for text, start in zip(found, warnings, strict=True)] == warnings


def test_two_publishers_of_a_cloud_share_its_scan_topic() -> None:
    connections = [Connection(i, "/points", CLOUD, "ros1", callerid=f"/n{i}") for i in range(2)]
    assert [route.targets for route in make_plan(connections, ConvertOptions()).routes] == [("/scan",), ("/scan",)]


@pytest.mark.parametrize(
    ("topics", "requests", "words"),
    [
        ({"/points": CLOUD, "/imu": IMU}, ["/pionts"], ["no topic /pionts", "did you mean /points?"]),
        (ONE, ["/imu"], ["/imu is sensor_msgs/msg/Imu", "PointCloud2 topics: /points"]),
        ({"/imu": IMU}, ["/points"], ["PointCloud2 topics: none"]),
        ({"/imu": IMU}, [], ["no PointCloud2 topic", "/imu (sensor_msgs/msg/Imu)"]),
        ({}, [], ["no topics"]),
        (
            {"/points": CLOUD, "/scan": SCAN},
            [],
            ["already has a topic /scan", "`topics=/points:=/points/scan`"],
        ),
        ({"/a": CLOUD, "/b": CLOUD}, ["/a:=/s", "/b:=/s"], ["/a, /b become one scan on /s", "target_frame=base_link"]),
        ({"/a": CLOUD, "/a/scan": SCAN, "/scan": SCAN}, ["/a"], ["`topics=/a:=/scan_2`"]),
    ],
)
def test_requests_that_cannot_be_met(topics: dict[str, str], requests: list[str], words: list[str]) -> None:
    with pytest.raises(TopicError) as caught:
        plan(topics, *requests)
    told = f"{caught.value} {caught.value.hint}"
    assert all(word in told for word in words), told


def test_topics_that_share_a_target_become_one_scan() -> None:
    topics = {"/a": CLOUD, "/b": CLOUD, "/c": SCAN, "/d": CLOUD}
    made = plan(topics, "/b:=/s", "/a:=/s", "/c:=/s", "/d", "/a:=/alone", **BASE)
    (combination,) = made.combinations
    assert (combination.sources, combination.target) == (("/b", "/a", "/c"), "/s")
    assert [[(task.targets, task.combination) for task in route.tasks] for route in made.routes] == [
        [(("/alone",), None), (("/s",), combination)],
        [(("/s",), combination)],
        [(("/s",), combination)],
        [(("/d/scan",), None)],
    ]
    led = plan(topics, "/b:=/s", "/a:=/s", **BASE, combining=Combining.of(lead="a"))
    assert led.combinations[0].sources == ("/a", "/b")
    with pytest.raises(TopicError, match="`lead` is /d, which is not one of the scan's topics: /b, /a"):
        plan(topics, "/b:=/s", "/a:=/s", **BASE, combining=Combining.of(lead="/d"))
    # A glob may name them.
    made = plan({"/l_1": CLOUD, "/l_2": CLOUD, "/imu": IMU}, "/l_*:=/s", **BASE)
    assert [each.sources for each in made.combinations] == [("/l_1", "/l_2")]
    with pytest.raises(TopicError, match="both become /c"):
        plan({"/a": SCAN, "/b": SCAN}, "/a:=/c", "/b:=/c", reverse=True)


def test_a_cloud_that_ros_did_not_serialise_is_not_converted() -> None:
    connections = [Connection(1, "/points", "sensor_msgs/msg/PointCloud2", "json")]
    with pytest.raises(TopicError, match="in json"):
        make_plan(connections, ConvertOptions())


def test_an_output_without_sources_has_the_only_topic() -> None:
    spec = ScanSpec(name="/low", place="scans.yaml, line 3")
    options = ConvertOptions(scans=(spec, ScanSpec(name="/high", topics=(TopicRequest("/a", "/high"),))))
    (route,) = make_plan([Connection(1, "/a", CLOUD, "ros1")], options).routes
    assert [(task.spec.name, task.targets) for task in route.tasks] == [("/low", ("/low",)), ("/high", ("/high",))]
    two = [Connection(i, topic, CLOUD, "ros1") for i, topic in enumerate(("/a", "/b"))]
    with pytest.raises(TopicError, match=r"scans.yaml, line 3, /low: it has no 'sources', and the recording has sev"):
        make_plan(two, options)


def test_two_outputs_cannot_have_one_topic() -> None:
    topics = (TopicRequest("/a", "/scan"),)
    specs = (ScanSpec(name="/scan", place="here", topics=topics, **each) for each in ({}, BASE))
    with pytest.raises(TopicError, match=r"/scan \(here\) and /scan \(here\) would both become /scan"):
        make_plan([Connection(1, "/a", CLOUD, "ros1")], ConvertOptions(scans=tuple(specs)))
