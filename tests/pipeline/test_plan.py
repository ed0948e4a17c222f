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


def plan(topics: dict[str, str], *requests: str, **options: Any) -> Plan:
    connections = [Connection(i, topic, kind, "ros1") for i, (topic, kind) in enumerate(topics.items())]
    own = {name: options.pop(name) for name in ("params", "combining", "reverse") if name in options}
    scan = ScanSpec(topics=tuple(map(TopicRequest.parse, requests)), **own)
    return make_plan(connections, ConvertOptions(scans=(scan,), **options))


def routes(made: Plan) -> dict[str, tuple[str | None, bool]]:
    """The topic that each becomes, if it is one, and whether it passes."""
    return {route.connection.topic: (next(iter(route.targets), None), route.passes) for route in made.routes}


def test_one_cloud_becomes_scan_and_is_left_out() -> None:
    assert routes(plan({"/points": CLOUD, "/imu": IMU})) == {
        "/points": ("/scan", False),
        "/imu": (None, True),
    }


def test_several_clouds_become_a_scan_each() -> None:
    made = plan({"/front/points": CLOUD, "/rear/points/": CLOUD})
    assert routes(made) == {
        "/front/points": ("/front/points/scan", False),
        "/rear/points/": ("/rear/points/scan", False),
    }


def test_requests_choose_and_rename_and_the_rest_passes() -> None:
    made = plan({"/a": CLOUD, "/b": CLOUD}, "/a:=/front_scan")
    assert routes(made) == {"/a": ("/front_scan", False), "/b": (None, True)}


def test_a_leading_slash_is_no_difference() -> None:
    assert routes(plan({"points": CLOUD}, "/points"))["points"] == ("/scan", False)
    assert routes(plan({"/points": CLOUD}, "points"))["/points"] == ("/scan", False)


def test_both_spellings_of_the_type_are_clouds() -> None:
    assert routes(plan({"/p": "sensor_msgs/msg/PointCloud2"}))["/p"] == ("/scan", False)


def test_keep_clouds_and_only_scans() -> None:
    topics = {"/points": CLOUD, "/imu": IMU}
    assert routes(plan(topics, keep_clouds=True))["/points"] == ("/scan", True)
    assert routes(plan(topics, only_scans=True)) == {"/points": ("/scan", False), "/imu": (None, False)}


def test_keep_and_drop_take_names_and_globs_and_drop_wins() -> None:
    topics = {"/points": CLOUD, "/cam/left": IMU, "/cam/right": IMU, "/imu": IMU}
    assert [t for t, r in routes(plan(topics, keep=("/cam/*",))).items() if r[1]] == [
        "/cam/left",
        "/cam/right",
    ]
    assert [t for t, r in routes(plan(topics, drop=("cam/*",))).items() if r[1]] == ["/imu"]
    assert [t for t, r in routes(plan(topics, keep=("/cam/*",), drop=("/cam/left",))).items() if r[1]] == ["/cam/right"]


def test_a_dropped_cloud_is_not_converted_unless_named() -> None:
    topics = {"/a": CLOUD, "/b": CLOUD}
    assert routes(plan(topics, drop=("/b",))) == {"/a": ("/scan", False), "/b": (None, False)}
    assert routes(plan(topics, "/b", drop=("/b",)))["/b"] == ("/scan", False)


def test_a_pattern_that_matches_nothing_is_worth_a_warning() -> None:
    assert plan({"/points": CLOUD, "/pose": IMU}, drop=("/camera/*",), keep=("/p*",)).warnings == (
        "`drop=/camera/*` matches no topic",
    )
    assert plan({"/points": CLOUD, "/tf": IMU}, drop=("/TF",), keep=("/tff",)).warnings == (
        "`keep=/tff` matches no topic; did you mean /tf?",
        "`drop=/TF` matches no topic; did you mean /tf?",
    )


def test_keep_is_about_what_is_not_converted() -> None:
    topics = {"/points": CLOUD, "/imu": IMU}
    (warning,) = plan(topics, keep=("/points",)).warnings
    assert warning.startswith("`keep=/points` matches only topics that are converted, and has no effect on them; ")
    assert plan(topics, keep=("/points",), keep_clouds=True).warnings == ()


def test_two_publishers_of_a_cloud_share_its_scan_topic() -> None:
    connections = [Connection(i, "/points", CLOUD, "ros1", callerid=f"/n{i}") for i in range(2)]
    assert [route.targets for route in make_plan(connections, ConvertOptions()).routes] == [("/scan",), ("/scan",)]


def test_a_cloud_becomes_every_scan_that_is_asked_for() -> None:
    made = plan({"/points": CLOUD, "/imu": IMU}, "/points:=/a", "points:=/b", "/points:=/a")
    assert [route.targets for route in made.routes] == [("/a", "/b"), ()]
    with_default = plan({"/points": CLOUD}, "/points", "/points:=/b")
    assert with_default.routes[0].targets == ("/scan", "/b")


@pytest.mark.parametrize(
    ("topics", "requests", "words"),
    [
        ({"/points": CLOUD, "/imu": IMU}, ["/pionts"], ["no topic /pionts", "did you mean /points?"]),
        (
            {"/points": CLOUD, "/imu": IMU},
            ["/imu"],
            ["/imu is sensor_msgs/msg/Imu", "PointCloud2 topics: /points"],
        ),
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
    params = ProjectionParams(target_frame="base_link")
    made = plan(topics, "/b:=/s", "/a:=/s", "/c:=/s", "/d", "/a:=/alone", params=params)
    (combination,) = made.combinations
    assert (combination.sources, combination.target) == (("/b", "/a", "/c"), "/s")
    tasks = {
        route.connection.topic: [(task.targets, task.combination) for task in route.tasks] for route in made.routes
    }
    assert tasks == {
        "/a": [(("/alone",), None), (("/s",), combination)],
        "/b": [(("/s",), combination)],
        "/c": [(("/s",), combination)],
        "/d": [(("/d/scan",), None)],
    }
    led = plan(topics, "/b:=/s", "/a:=/s", params=params, combining=Combining.of(lead="a"))
    assert led.combinations[0].sources == ("/a", "/b")


def test_a_glob_may_name_the_topics_of_one_scan() -> None:
    params = ProjectionParams(target_frame="base_link")
    made = plan({"/l_1": CLOUD, "/l_2": CLOUD, "/imu": IMU}, "/l_*:=/s", params=params)
    assert [each.sources for each in made.combinations] == [("/l_1", "/l_2")]


def test_scans_that_are_rebinned_keep_their_topic_unless_they_are_written_too() -> None:
    rebin = Combining.of(rebin=True)
    assert routes(plan({"/scan": SCAN, "/points": CLOUD}, combining=rebin)) == {
        "/scan": ("/scan", False),
        "/points": (None, True),
    }
    assert routes(plan({"/scan": SCAN}, combining=rebin, keep_clouds=True))["/scan"] == ("/scan_rebinned", True)


def test_scans_do_not_become_one_cloud() -> None:
    with pytest.raises(TopicError, match="both become /c"):
        plan({"/a": SCAN, "/b": SCAN}, "/a:=/c", "/b:=/c", reverse=True)


def test_a_taken_topic_is_free_once_it_is_dropped() -> None:
    assert routes(plan({"/points": CLOUD, "/scan": SCAN}, drop=("/scan",)))["/points"] == ("/scan", False)
    assert routes(plan({"/points": CLOUD, "/scan": SCAN}, only_scans=True))["/points"] == ("/scan", False)


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
