"""Tries a command that `info` proposes, on the clouds that it has read: what is said of it, and what its scans see."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.advice.checks import request_warnings
from pc2scan.advice.checks.clouds import KnownTransforms
from pc2scan.advice.first_clouds import FirstCloud, judge
from pc2scan.advice.measurements import Measurements
from pc2scan.conversion.cloud_to_scan import CloudToScan
from pc2scan.conversion.stages import PlaceStage
from pc2scan.core.percentiles import percentiles
from pc2scan.core.points import Points
from pc2scan.core.rigid import Rigid
from pc2scan.core.rule import PointCounts
from pc2scan.core.scene import CloudSample, find_ground, on_rising_plane, thin_points
from pc2scan.core.terrain import on_ground
from pc2scan.errors import Pc2ScanError
from pc2scan.options.call import Options
from pc2scan.requests import conversion_of
from pc2scan.transforms.placing import Placer

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from pc2scan.request.options import ScanSpec

    from .lidar import Lidar

#: How many clouds of a topic are tried, and how many points of each.
_CLOUDS = 3
_POINTS = 60_000

#: A beam that ends on the ground, or misses what stands on it, is off by more than this, metres.
_OFF = 0.2

#: A robot's floor is looked for from so far above its frame, metres.
_ABOVE = 0.5

_NO_FLOOR = "the robot tilts, and no floor is visible: returns on rising ground would not be noticed"

#: Slopes are measured from this distance on, metres.
_NEAR = 2.0


class Trial(NamedTuple):
    """What a command makes of the clouds of a topic.

    Attributes
    ----------
    on_ground
        The share of its returns that are on the ground.
    seen
        The share of the beams that things above the ground fill, within the heights, which have a return there.
    slope
        How steeply the ground rises above the lower limit, metres a metre (98 %).
    findings
        What a conversion would say.
    """

    on_ground: float = 0.0
    seen: float = 1.0
    slope: float = 0.0
    findings: tuple[str, ...] = ()


def tried(options: Mapping[str, Any], lidar: Lidar) -> Trial:
    """Return what the options of a proposed command make of a topic's clouds.

    Parameters
    ----------
    options, lidar
        The command and the topic, which keeps from trial to trial which points are on the ground.
    """
    given = {name: value for name, value in options.items() if name != "destination"}
    try:
        request = conversion_of(Options("convert", given))
        spec, findings = request.scan, request_warnings(request, lidar.recorded)
        clouds, merges = lidar.tried_clouds(_CLOUDS, _POINTS)
        is_placed = bool(lidar.mounting.static_tf) or spec.level or lidar.is_registered
        if is_placed and not lidar.is_registered:
            clouds = [lidar.in_target(each).T for each in clouds]
        clouds = [each for each in clouds if each.size]
        if spec.level:
            clouds = [np.concatenate(clouds, axis=1)] if merges else clouds
            levelled: list[NDArray[Any]] = [level.T for each in clouds if (level := _levelled(each.T)) is not None]
            if clouds and not levelled:
                findings.append(_NO_FLOOR)
            clouds = levelled
        if not clouds:
            return Trial(findings=tuple(findings))
        scans, first = _scans(spec, lidar, clouds, is_placed=is_placed, merges=merges)
    except Pc2ScanError as err:
        return Trial(findings=(str(err),))
    if not is_placed:
        known = KnownTransforms("", lambda: lidar.buffer, lidar.buffer if spec.needs_transforms else None)
        findings += judge(lidar.topic, spec, first, known).warnings
    if merges:
        clouds = [np.concatenate(clouds, axis=1)]
    placed = clouds if is_placed else [lidar.in_target(points).T for points in clouds]
    floor = lidar.mounting.heights.floor if lidar.mounting.heights is not None else None
    low = lidar.ground = lidar.ground or [_on_ground(points, floor) for points in placed]
    above = [points[:, ~ground] for points, ground in zip(clouds, low, strict=True)]
    standing, _ = _scans(replace(spec, filters=()), lidar, above, is_placed=is_placed, merges=merges)
    scan, stand = np.concatenate(scans), np.concatenate(standing)
    returns = np.isfinite(scan)
    on_ground_share = (returns & ~(scan > stand - _OFF)).sum() / max(returns.sum(), 1)
    with np.errstate(invalid="ignore"):
        seen = (np.abs(scan - stand) < _OFF).sum() / max(np.isfinite(stand).sum(), 1)
    slope = max(_slope(points[:, each], spec.params.min_height) for points, each in zip(placed, low, strict=True))
    return Trial(float(on_ground_share), float(seen), slope, tuple(findings))


def _on_ground(points: NDArray[np.floating[Any]], floor: float | None) -> NDArray[np.bool_]:
    mask = on_ground(*points)
    return mask if floor is None else mask | on_rising_plane(points.T.astype(np.float64), floor)


def _slope(ground: NDArray[np.floating[Any]], low: float) -> float:
    x, y, z = ground[:, (ground[2] > low) & (np.hypot(ground[0], ground[1]) > _NEAR)]
    return percentiles((z - low) / np.hypot(x, y), 98)[0] if x.size else 0.0


def _levelled(points: NDArray[np.floating[Any]]) -> NDArray[np.float64] | None:
    """Return points, (N, 3), of a robot that tilts as if it did not, by their floor; None if none is visible."""
    above = points - (0.0, 0.0, _ABOVE)
    ground = find_ground(thin_points(*above.T))
    if ground.kind != "level" or ground.up is None:
        return None
    roll, pitch, _ = ground.level_from_frame
    level = Rigid.from_rpy(roll, pitch, 0.0, (0.0, 0.0, _ABOVE))
    return np.asarray(level.apply(above))


def _scans(
    spec: ScanSpec, lidar: Lidar, clouds: Sequence[NDArray[Any]], *, is_placed: bool, merges: bool
) -> tuple[list[NDArray[np.float64]], list[FirstCloud]]:
    """Return the ranges of each cloud's scan, infinite without a return, and what the checks of first clouds read.

    The clouds are in their own frame, or placed in that of the scans; they may make one scan together.
    """
    params, frame = spec.params, lidar.target if is_placed else lidar.mounting.judged_in
    placer = Placer() if is_placed else Placer(params.target_frame, "", lidar.buffer)
    filters = [each for each in spec.filters if not is_placed or each.name in {"ground", "min_height_slope"}]
    measured = {lidar.topic: Measurements(0.0, azimuth_step=lidar.step or 0.0)}
    _, *select, project = CloudToScan(replace(spec, filters=tuple(filters)), placer, measured).steps(lidar.topic)
    whole = [Points(0, 0, frame, dict(zip("xyz", xyz, strict=True))) for xyz in clouds]
    chosen = [PlaceStage(placer)(points) for points in whole]
    for step in select:
        chosen = [step(each) for each in chosen]
    if merges:
        rejected = sum((Counter(each.rejected) for each in chosen), Counter())
        xyz = [np.concatenate([each.points.field(axis).ravel() for each in chosen]) for axis in "xyz"]
        points = Points(0, 0, frame, dict(zip("xyz", xyz, strict=True)))
        chosen = [replace(chosen[0], points=points, rejected=rejected)]
    ranges: list[NDArray[np.float64]] = []
    counts = [PointCounts()] * len(whole)
    for number, selected in enumerate(chosen):
        scan = project(selected)
        read = scan.message.ranges.astype(np.float64)
        read[~((read >= params.range_min) & (read <= params.range_max))] = np.inf
        ranges.append(read)
        counts[number] = scan.counts
    place = placer.place(frame, 0)
    samples = [CloudSample.of(points).placed_in(place.frame_id, place.target_from_source) for points in whole]
    return ranges, [FirstCloud(*both) for both in zip(samples, counts, strict=True)]
