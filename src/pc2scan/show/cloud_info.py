"""The properties of a topic's clouds, from a sample spread over the recording, and their mounting, from the first."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.errors import DecodeError, TransformError, leading
from pc2scan.messages.clouds import CLOUDS
from pc2scan.text import counted

from .scan_topic import count_range

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from pc2scan.model import RawMessage
    from pc2scan.result import Part
    from pc2scan.transforms.mounting import Mounting
    from pc2scan.transforms.placing import Placer


@dataclass(frozen=True, slots=True)
class CloudInfo:
    """The properties of the clouds of one topic, from a sample spread over the recording.

    Attributes
    ----------
    sampled
        How many clouds were read.
    frames
        All ``frame_id`` of these clouds.
    fields
        Name and datatype, in the message's order.
    shape
        Height and width of the first cloud.
    points_min, points_max
        Points per cloud.
    nan_share
        Share of points with a NaN coordinate.
    zero_share
        Share of points at exactly (0, 0, 0), which some drivers write for no return.
    limits
        The least and the largest finite x, y, z and range, which is hypot(x, y); empty if there are none.
    above_zero_share
        Share of points with z > 0, which upstream's default min_height keeps.
    target_frame
        The frame of x, y and z; empty for the clouds' own.
    mounting
        How the clouds are mounted, and which options suit that; None if no cloud could be decoded.
    problems
        Why sampled clouds cannot be decoded or transformed, each reason once.
    """

    topic: str
    sampled: int = 0
    frames: tuple[str, ...] = ()
    fields: tuple[tuple[str, str], ...] = ()
    shape: tuple[int, int] = (0, 0)
    points_min: int = 0
    points_max: int = 0
    nan_share: float = 0.0
    zero_share: float = 0.0
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    above_zero_share: float = 0.0
    target_frame: str = ""
    mounting: Mounting | None = None
    problems: tuple[str, ...] = ()

    def body(self) -> Iterator[Part]:
        """Yield the parts of `Info` about the clouds."""
        yield f"{leading(self.topic)}: {counted(self.sampled, 'cloud')} sampled"
        yield from (f"  cannot be described: {problem}" for problem in self.problems)
        if not self.fields:
            return
        points = count_range(self.points_min, self.points_max)
        height, width = self.shape
        yield f"  frame   {', '.join(map(repr, self.frames))}"
        yield f"  points  {points} a cloud ({height} x {width})"
        yield f"  fields  {', '.join(map(' '.join, self.fields))}"
        yield f"  NaN {self.nan_share:.1%}, (0, 0, 0) {self.zero_share:.1%}, z > 0 {self.above_zero_share:.1%}"
        if self.limits:
            limits = ", ".join(f"{name} {low:.2f} to {high:.2f}" for name, (low, high) in self.limits.items())
            yield f"  metres  {limits}" + (f" in {self.target_frame}" if self.target_frame else "")


class ShownCloud(NamedTuple):
    """What is kept of a cloud: its size, some of its points.

    Attributes
    ----------
    points
        (3, N), without those at (0, 0, 0) or with NaN.
    nans, zeros
        How many of the points that were examined have NaN, and how many are at (0, 0, 0).
    shape, fields
        As in `CloudInfo`.
    """

    frame_id: str
    stamp_ns: int
    points: NDArray[np.floating[Any]]
    nans: int
    zeros: int
    shape: tuple[int, int]
    fields: tuple[tuple[str, str], ...]


def sample_cloud(most: int, message: RawMessage) -> ShownCloud | str:
    """Return what is kept of a cloud, so many points at most, or why it cannot be described."""
    fields = []
    try:
        cloud = CLOUDS[message.connection.ros_type](message.connection.serialization)(message.data)
        coordinates = cloud.xyz()
        for name in cloud.fields:
            # Fields that cannot be read are not needed.
            with suppress(DecodeError):
                fields.append((name, cloud.field(name).dtype.name))
        step = -(-coordinates[0].size // most) or 1
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            x, y, z = (_thinned(column, step) for column in coordinates)
            # Points at the sensor are no returns, wherever the sensor is in the target frame.
            zero = (x == 0) & (y == 0) & (z == 0)
            nan = np.isnan(x) | np.isnan(y) | np.isnan(z)
    except DecodeError as err:
        return _problem(err)
    height, width = np.atleast_2d(coordinates[0]).shape
    points, layout = np.stack([x, y, z])[:, ~(zero | nan)], ((height, width), tuple(fields))
    return ShownCloud(cloud.frame_id, cloud.stamp_ns, points, int(nan.sum()), int(zero.sum()), *layout)


def describe_clouds(
    topic: str, sampled: list[ShownCloud | str], places: Placer, mounting: Mounting | None
) -> tuple[CloudInfo, list[ShownCloud]]:
    """Return the properties of a topic's clouds, and the clouds, which leave ``sampled``, in the frame of scans.

    Parameters
    ----------
    topic
        The topic.
    sampled
        What `sample_cloud` returned.
    places
        The frame of scans.
    mounting
        How the first clouds are mounted.
    """
    count = len(sampled)
    problems: dict[str, None] = {}
    clouds: list[ShownCloud] = []
    while sampled:
        cloud = sampled.pop(0)
        if isinstance(cloud, str):
            problems[cloud] = None
            continue
        try:
            place = places.place(cloud.frame_id, cloud.stamp_ns)
        except TransformError as err:
            problems[_problem(err)] = None
            continue
        if place.target_from_source is not None:
            points = place.target_from_source.apply(cloud.points.T).T
            # Of infinite coordinates.
            cloud = cloud._replace(points=points[:, ~np.isnan(points).any(axis=0)])
        clouds.append(cloud)
    info = CloudInfo(topic, count, target_frame=places.target_frame, problems=tuple(problems))
    if not clouds:
        return info, clouds
    parts, sizes = [cloud.points for cloud in clouds], [math.prod(cloud.shape) for cloud in clouds]
    kept, nans, zeros = np.sum([(each.points.shape[1], each.nans, each.zeros) for each in clouds], axis=0).tolist()
    examined = max(1, kept + nans + zeros)
    return replace(
        info,
        frames=tuple(dict.fromkeys(cloud.frame_id for cloud in clouds)),
        fields=clouds[0].fields,
        shape=clouds[0].shape,
        points_min=min(sizes),
        points_max=max(sizes),
        nan_share=nans / examined,
        zero_share=zeros / examined,
        limits=_limits(parts),
        above_zero_share=sum(int((part[2] > 0).sum()) for part in parts) / max(1, kept),
        mounting=mounting,
    ), clouds


def _problem(err: DecodeError | TransformError) -> str:
    return f"{err.message} ({err.hint})" if err.hint else err.message


def _thinned(column: NDArray[Any], step: int) -> NDArray[np.floating[Any]]:
    """Return every ``step``-th coordinate: float32 unchanged, all others as float64, which represents them exactly.

    Rows with gaps between them have no flat view, so their columns are thinned.
    """
    column = column[::step] if column.ndim == 1 else column[:, ::step].ravel()
    return column.astype(np.float32 if column.dtype.kind == "f" and column.dtype.itemsize == 4 else np.float64)


def _limits(parts: Sequence[NDArray[np.floating[Any]]]) -> dict[str, tuple[float, float]]:
    """Return the least and the largest finite x, y, z and range of points, (3, N) of each cloud."""
    limits: dict[str, tuple[float, float]] = {}
    for x, y, z in parts:
        for name, values in (("x", x), ("y", y), ("z", z), ("range", np.hypot(x, y, dtype=np.float64))):
            finite = values[np.isfinite(values)]
            if finite.size:
                low, high = limits.get(name, (math.inf, -math.inf))
                limits[name] = min(low, float(finite.min())), max(high, float(finite.max()))
    return limits
