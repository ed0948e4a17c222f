"""The properties of a topic's clouds, from a sample spread over the recording, and their mounting, from the first."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.errors import DecodeError, TransformError, leading
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.pointcloud2 import DATATYPES, POINTCLOUD2, decode_pointcloud2
from pc2scan.text import counted

from .scan_topic import count_range

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.points import Points
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
        Name, datatype and offset in bytes (0 for messages other than PointCloud2), in the message's order.
    shape
        Height and width of the first cloud.
    point_step
        Bytes of a point; 0 for messages other than PointCloud2.
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
    fields: tuple[tuple[str, str, int], ...] = ()
    shape: tuple[int, int] = (0, 0)
    point_step: int = 0
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
        is_laid_out = self.point_step > 0
        yield f"  points  {points} a cloud ({height} x {width})" + f", {self.point_step} bytes each" * is_laid_out
        fields = [f"{name} {kind}" + f" @{offset}" * is_laid_out for name, kind, offset in self.fields]
        yield f"  fields  {', '.join(fields)}"
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
    returns, zeros
        How many are not at (0, 0, 0), with NaN or not, and how many are.
    layout
        The attributes of `CloudInfo`: shape, point_step and fields.
    """

    frame_id: str
    stamp_ns: int
    size: int
    points: NDArray[np.floating[Any]]
    returns: int
    zeros: int
    layout: tuple[tuple[int, int], int, tuple[tuple[str, str, int], ...]]


def sample_cloud(most: int, message: RawMessage) -> ShownCloud | str:
    """Return what is kept of a cloud, so many points at most, or why it cannot be described."""
    try:
        cloud = CLOUDS[message.connection.ros_type](message.connection.serialization)(message.data)
        coordinates = cloud.xyz()
        count = coordinates[0].size
        step = -(-count // most) or 1
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            x, y, z = (_thinned(column, step) for column in coordinates)
            # Points at the sensor are no returns, wherever the sensor is in the target frame.
            zero = (x == 0) & (y == 0) & (z == 0)
            good = ~(zero | np.isnan(x) | np.isnan(y) | np.isnan(z))
        layout = _layout(cloud, message)
    except DecodeError as err:
        return _problem(err)
    points, zeros = np.stack([x[good], y[good], z[good]]), int(np.count_nonzero(zero))
    return ShownCloud(cloud.frame_id, cloud.stamp_ns, count, points, x.size - zeros, zeros, layout)


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
    placed: list[ShownCloud] = []
    while sampled:
        sample = sampled.pop(0)
        if isinstance(sample, str):
            problems[sample] = None
            continue
        try:
            place = places.place(sample.frame_id, sample.stamp_ns)
        except TransformError as err:
            problems[_problem(err)] = None
            continue
        if place.target_from_source is not None:
            points = place.target_from_source.apply(sample.points.T).T
            # Of infinite coordinates.
            sample = sample._replace(points=points[:, ~np.isnan(points).any(axis=0)])
        placed.append(sample)
    target, why = places.target_frame, tuple(problems)
    if not placed:
        return CloudInfo(topic, count, target_frame=target, problems=why), placed
    (shape, point_step, fields), sizes = placed[0].layout, [sample.size for sample in placed]
    frames, parts = dict.fromkeys(sample.frame_id for sample in placed), [sample.points for sample in placed]
    returns, zeros = (sum(getattr(sample, name) for sample in placed) for name in ("returns", "zeros"))
    kept, total = sum(part.shape[1] for part in parts), max(1, returns + zeros)
    shares = (returns - kept) / total, zeros / total
    above = sum(int((part[2] > 0).sum()) for part in parts) / max(1, kept)
    layout = fields, shape, point_step, min(sizes), max(sizes)
    return CloudInfo(
        topic, count, tuple(frames), *layout, *shares, _limits(parts), above, target, mounting, why
    ), placed


def _problem(err: DecodeError | TransformError) -> str:
    return f"{err.message} ({err.hint})" if err.hint else err.message


def _thinned(column: NDArray[Any], step: int) -> NDArray[np.floating[Any]]:
    """Return every ``step``-th coordinate: float32 unchanged, all others as float64, which represents them exactly.

    Rows with gaps between them have no flat view, so their columns are thinned.
    """
    column = column[::step] if column.ndim == 1 else column[:, ::step].ravel()
    return column.astype(np.float32 if column.dtype.kind == "f" and column.dtype.itemsize == 4 else np.float64)


def _layout(points: Points, message: RawMessage) -> tuple[tuple[int, int], int, tuple[tuple[str, str, int], ...]]:
    if message.connection.ros_type != POINTCLOUD2:
        shape = points.field("x").shape
        fields = tuple((name, values.dtype.name, 0) for name, values in points.fields.items())
        return (shape[0] if len(shape) > 1 else 1, shape[-1]), 0, fields
    cloud = decode_pointcloud2(message.data, message.connection.serialization)
    kinds = {number: np.dtype(code).name for number, code in DATATYPES.items()}
    fields = tuple((f.name, kinds.get(f.datatype, f"datatype {f.datatype}"), f.offset) for f in cloud.fields)
    return (cloud.height, cloud.width), cloud.point_step, fields


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
