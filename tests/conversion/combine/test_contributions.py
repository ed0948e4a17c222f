"""Scans of several messages: equal to the scan of one cloud with all their points, where nothing moves."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.advice.measurements import Measurements
from pc2scan.conversion.combine.contributions import Contribution, MessagesToScan
from pc2scan.conversion.combine.grouping import Grouper, Nearest
from pc2scan.conversion.steps import CloudToScan, ConvertedMessage
from pc2scan.core.params import ProjectionParams
from pc2scan.core.points import Points
from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.request.filters import MinHeightSlope, Where
from pc2scan.request.spec import Combining, ScanSpec, TopicRequest
from pc2scan.transforms.builder import TransformBuilder
from pc2scan.transforms.placing import Placer
from support.conversions import stepped

T0 = 1_700_000_000_000_000_000
MOUNTS = {
    "a": Rigid.from_rpy(0.1, -0.2, 0.7, (0.3, -0.1, 0.5)),
    "b": Rigid.from_rpy(0.0, 0.05, 3.0, (-0.4, 0.2, 0.6)),
    "c": Rigid.from_rpy(-0.1, 0.0, -1.5, (0.0, 0.0, 1.0)),
}
TOPICS = tuple(f"/{frame}" for frame in MOUNTS)


def frames() -> Placer:
    builder = TransformBuilder()
    builder.add([("base_link", frame, T0, *mount.pose) for frame, mount in MOUNTS.items()], static=True)
    return Placer("base_link", "", builder.build(), 0)


def conversion(params: ProjectionParams, **options: Any) -> MessagesToScan:
    spec = ScanSpec(topics=tuple(TopicRequest(topic, "/scan") for topic in TOPICS), params=params, **options)
    return MessagesToScan(spec, TOPICS, frames(), Measurements(0.1), lambda: Grouper(Nearest(windows_ns=(0, 0, 0)), 3))


def cloud(rng: np.random.Generator, frame: str, stamp_ns: int) -> Points:
    x, y, z = rng.normal(0, 3, (3, int(rng.integers(0, 200)))).astype(np.float32)
    x[rng.uniform(size=x.size) < 0.05] = np.nan
    intensity = rng.uniform(0, 100, x.size).astype(np.float32)
    return Points(0, stamp_ns, frame, {"x": x, "y": y, "z": z, "intensity": intensity})


def together(made: MessagesToScan, clouds: list[Any]) -> ConvertedMessage:
    contribution: list[Contribution] = [
        made.steps(topic).project(each) for topic, each in zip(TOPICS, clouds, strict=True)
    ]
    return made.scan(contribution[0], contribution)


def concatenated(clouds: list[Points]) -> Points:
    """All points in base_link, as tf2_sensor_msgs transforms clouds."""
    fields: dict[str, Any] = {}
    with np.errstate(invalid="ignore"):
        placed = [MOUNTS[each.frame_id].apply(np.stack(each.xyz(), axis=1)) for each in clouds]
    for axis, name in enumerate("xyz"):
        fields[name] = np.concatenate([each[:, axis] for each in placed])
    fields["intensity"] = np.concatenate([each.field("intensity") for each in clouds])
    return Points(0, clouds[0].stamp_ns, "base_link", fields)


def scan_of(params: ProjectionParams, points: Points, filters: Any = ()) -> ConvertedMessage:
    spec = ScanSpec(params=params, filters=filters)
    result = stepped(CloudToScan(spec, frames(), {"/a": Measurements(0.1)}), "/a", points)
    assert isinstance(result, ConvertedMessage)
    return result


def same(one: ConvertedMessage, other: ConvertedMessage) -> None:
    assert encode_laserscan(one.message, "cdr") == encode_laserscan(other.message, "cdr")
    assert one.counts == other.counts
    assert one.empty == other.empty


@given(
    st.integers(0, 2**32),
    st.sampled_from(
        [{}, {"intensity_field": "intensity"}, {"reduce": "mean"}, {"geometry": "centered", "reduce": "surface"}]
    ),
    st.booleans(),
)
def test_without_motion_the_scan_is_that_of_joined_clouds(seed: int, choice: dict[str, Any], filtered: bool) -> None:
    rng = np.random.default_rng(seed)
    params = ProjectionParams(target_frame="base_link", min_height=-0.5, range_max=6.0, angle_increment=0.05, **choice)
    filters = (Where("intensity > 20"), MinHeightSlope(-0.5, 0.05)) if filtered else ()
    # Stamps differ, and it makes no difference: the sensors are mounted rigidly.
    clouds = [cloud(rng, frame, T0 + number * 1_000_000) for number, frame in enumerate(MOUNTS)]
    same(together(conversion(params, filters=filters), clouds), scan_of(params, concatenated(clouds), filters))


def test_heights_of_beams_count_only_if_they_are_asked_for() -> None:
    flat = LaserScan(0, T0, "a", -1.0, 1.0, 0.25, 0.0, 0.1, 0.1, 10.0, np.full(9, 2.0, np.float32))
    for params, kept in ((ProjectionParams(), 9), (ProjectionParams(min_height=0.1), 0)):
        spec = ScanSpec(params=params, combining=Combining(rebin=True))
        made = MessagesToScan(spec, ["/a"], Placer(), Measurements(0.1), None)
        result = stepped(made, "/a", flat)
        assert (result.counts.used, result.counts.height) == (kept, 9 - kept)
