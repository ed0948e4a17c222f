from __future__ import annotations

import pytest

from pc2scan.errors import UsageError
from pc2scan.options.moment import TimeBound
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.scan_spec import TopicRequest


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", TimeBound(0)),
        ("12.5", TimeBound(12_500_000_000)),
        (".25", TimeBound(250_000_000)),
        ("0.000000001", TimeBound(1)),
        ("@12.5", TimeBound(12_500_000_000, absolute=True)),
        # A float would lose the last digits of these.
        ("1604515190.231374463", TimeBound(1604515190231374463, absolute=True)),
        ("1604515190231374463", TimeBound(1604515190231374463, absolute=True)),
        ("@1604515190231374463", TimeBound(1604515190231374463, absolute=True)),
        ("2020-11-04T18:39:50.231374Z", TimeBound(1604515190231374000, absolute=True)),
        ("2020-11-04T19:39:50.231374463+01:00", TimeBound(1604515190231374463, absolute=True)),
        ("2020-11-04 19:39:50,25+0100", TimeBound(1604515190250000000, absolute=True)),
        ("2020-11-04 19:39:50+01:00", TimeBound(1604515190000000000, absolute=True)),
        ("2020-11-04T18:39:50", TimeBound(1604515190000000000, absolute=True)),
    ],
)
def test_times(text: str, expected: TimeBound) -> None:
    assert TimeBound.parse(text) == expected


@pytest.mark.parametrize("text", ["", "x", "-1", "1e3", "nan", "@", "@x", "12:30"])
def test_what_is_not_a_time(text: str) -> None:
    with pytest.raises(UsageError, match="not a time"):
        TimeBound.parse(text)


def test_relative_times_count_from_the_beginning() -> None:
    assert TimeBound(5).resolve(1000) == 1005
    assert TimeBound(5, absolute=True).resolve(1000) == 5


@pytest.mark.parametrize(
    ("text", "expected"),
    [("/points", TopicRequest("/points")), ("/points:=/scan", TopicRequest("/points", "/scan"))],
)
def test_topics(text: str, expected: TopicRequest) -> None:
    assert TopicRequest.parse(text) == expected


@pytest.mark.parametrize("text", ["", ":=", "/points:=", ":=/scan"])
def test_what_is_not_a_topic(text: str) -> None:
    with pytest.raises(UsageError, match="not a topic"):
        TopicRequest.parse(text)


def test_contradictions_are_refused() -> None:
    with pytest.raises(UsageError, match="only_scans"):
        ConvertOptions(only_scans=True, keep_clouds=True)
