"""Figures for reports: clouds from above and from the side, with the height band and the scan made of them."""

from __future__ import annotations

import io
import math
import shlex
import warnings
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pc2scan.core.layout import TURN
from pc2scan.core.project import Projector
from pc2scan.errors import UsageError, visible
from pc2scan.files.outputs import files_output, inputs_of, refuse_overlap
from pc2scan.parsing import conversion_of, first_output

from .shots import Picture, opened, take_shots, title_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.core.params import ProjectionParams
    from pc2scan.options.call import Options
    from pc2scan.parsing import Warn

    from .shots import Shot, Shots

#: The formats of figures, by the suffix of the file, and what matplotlib writes into them that differs each time.
_FORMATS = {"png": ("Software",), "svg": ("Date", "Creator"), "pdf": ("CreationDate", "Creator", "Producer")}

#: Maximum number of columns of a figure; more are too small to read.
_MOST_CLOUDS = 24

#: Okabe and Ito's colours, which colour-blind people can distinguish; the same as on pages.
_COLOURS = {"used": "#0072b2", "height": "#e69f00", "other": "#9aa7b3"}
_SCAN, _BAND = "#d1495b", "#0b6e99"

#: The width of a view, and its smallest and largest height, in inches.
_WIDTH, _LOWEST, _HIGHEST = 4.2, 0.8, 6.0
#: Space for numbers and names beside a view, and above and below all views, in inches.
_BESIDE, _AROUND = 0.7, 2.0

#: Maximum number of points of a view. More could not be distinguished, and a vector graphic would store them all.
_MOST_POINTS = 40_000

#: Share of the points at either end of an axis that may be outside of the picture.
_OUTLIERS = 0.01


class Plot(Picture):
    """What is known about a figure."""

    __slots__ = ()

    kind: ClassVar[str] = "figure"


def plot(sources: Sequence[Path], destination: Path, options: Options, *, warn: Warn | None = None) -> Plot:
    """Draw clouds; see `pc2scan.plot`."""
    request = first_output(conversion_of(options, warn), "shown", warn)
    kind = destination.suffix.lower().removeprefix(".")
    if kind not in _FORMATS:
        suffix = f"'.{kind}'" if kind else "no suffix"
        text = f"has {suffix}, a figure is one of .{', .'.join(_FORMATS)}"
        raise UsageError(text, path=destination, hint=f"such as `destination={shlex.quote(destination.stem)}.png`")
    refuse_overlap(inputs_of(sources, options.tf_from, request.files), [destination])
    with (
        files_output([destination], overwrite=options.overwrite) as deliver,
        opened(sources, request, options, warn, _MOST_CLOUDS) as recording,
    ):
        taken = take_shots(recording, level=True)
        figure = _figure(taken, title_of(sources), kind)
        deliver([figure])
        told = (*request.notes, *taken.warnings)
        return Plot(str(destination), len(figure), tuple(taken.notes), told, taken.damage)


def _figure(taken: Shots, title: str, kind: str) -> bytes:
    """Draw clouds, one in each column, and return the bytes of the file."""
    try:
        import matplotlib as mpl  # noqa: PLC0415  # an extra, and heavy
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as err:
        raise UsageError("figures need matplotlib, which is not installed", hint='pip install "pc2scan[plot]"') from err
    columns = len(taken.shots)
    # No date, no version and no random ids, so that the same input gives the same bytes.
    with warnings.catch_warnings(), mpl.rc_context({"svg.hashsalt": "pc2scan", "text.parse_math": False}):
        # No warnings about letters that the font lacks.
        warnings.simplefilter("ignore", UserWarning)
        placed = [_place_points(shot) for shot in taken.shots]
        limits = [_limits(values) for values in zip(*placed, strict=True)]
        across, *heights = (high - low for low, high in limits)
        inches = [min(_HIGHEST, max(_LOWEST, _WIDTH * height / across)) for height in heights]
        figure = Figure(((_WIDTH + _BESIDE) * columns, sum(inches) + _AROUND), layout="constrained", dpi=150)
        figure.suptitle(visible(title), fontsize=11)
        axes: Any = figure.subplots(2, columns, squeeze=False, height_ratios=inches)
        for column, (shot, points) in enumerate(zip(taken.shots, placed, strict=True)):
            _draw(axes[0, column], axes[1, column], shot, points, taken.params, limits)
        named = {name: line for axis in axes[0] for line, name in zip(*axis.get_legend_handles_labels(), strict=True)}
        style: dict[str, Any] = {"loc": "outside lower center", "fontsize": 8, "frameon": False, "markerscale": 3}
        figure.legend(list(named.values()), list(named), ncols=4 if columns > 1 else 2, **style)
        file = io.BytesIO()
        figure.savefig(file, format=kind, metadata=dict.fromkeys(_FORMATS[kind]))
    return file.getvalue()


def _draw(
    above: Any,
    side: Any,
    shot: Shot,
    points: NDArray[np.float32],
    params: ProjectionParams,
    limits: Sequence[tuple[float, float]],
) -> None:
    x, y, z = points
    kept = np.ones(x.size, np.bool_) if shot.filtered is None else shot.filtered == 0
    ranges = Projector(params)(x[kept], y[kept], z[kept]).ranges.astype(np.float64)
    layout = params.layout
    with np.errstate(over="ignore", invalid="ignore"):
        distance = np.hypot(x, y, dtype=np.float64)
        turned = np.mod(np.arctan2(y, x, dtype=np.float64) - params.angle_min, TURN)
        height = kept & ((z < params.min_height) | (z > params.max_height))
        inside = (distance >= params.range_min) & (distance <= params.range_max)
    used = kept & ~height & inside & (turned <= params.angle_max - params.angle_min)
    angles = layout.angle_min + np.arange(layout.count) * layout.angle_increment
    returns = np.isfinite(ranges) & (ranges != np.float64(params.empty_range))
    ends = ranges[returns] * np.cos(angles[returns]), ranges[returns] * np.sin(angles[returns])
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    step = max(1, math.ceil(len(x) / _MOST_POINTS))
    for name, chosen, label in (
        ("other", ~used & ~height, "rejected: range, sector, filters"),
        ("height", height, "rejected: height"),
        ("used", used, "used"),
    ):
        some = np.flatnonzero(chosen & known)[::step]
        if not some.size:
            continue
        style = {"s": 1.2, "c": _COLOURS[name], "linewidths": 0, "label": label, "rasterized": True}
        above.scatter(x[some], y[some], **style)
        side.scatter(x[some], z[some], **style)
    above.scatter(*ends, s=5, c=_SCAN, linewidths=0, label="scan", zorder=3)
    for axes, vertical in ((above, limits[1]), (side, limits[2])):
        axes.plot(0, 0, "+", c="k", ms=8)
        axes.set(xlim=limits[0], ylim=vertical)
        axes.set_aspect("equal", adjustable="box")
        axes.tick_params(labelsize=8)
        axes.grid(visible=True, lw=0.3, c="#d5dce3")
        axes.set_axisbelow(True)
    low, high = limits[2]
    side.axhspan(max(low, params.min_height), min(high, params.max_height), color=_BAND, alpha=0.12, lw=0)
    for limit in (params.min_height, params.max_height):
        if low < limit < high:
            side.axhline(limit, c=_BAND, lw=0.9)
    above.set_title(f"{visible(shot.topic)}\n{shot.moment}", fontsize=8)
    above.set_ylabel("y (m)", fontsize=8)
    side.set_ylabel("z (m)", fontsize=8)
    side.set_xlabel(f"x (m) in {visible(shot.place.frame_id)}", fontsize=8)


def _limits(values: Sequence[NDArray[Any]]) -> tuple[float, float]:
    """Return the limits of an axis in all columns, which show the sensor and all but the farthest points."""
    low = high = 0.0
    for column in values:
        known = column[np.isfinite(column)].astype(np.float64)
        if known.size:
            ends = np.quantile(known, (_OUTLIERS, 1 - _OUTLIERS)).tolist()
            low, high = min(low, ends[0]), max(high, ends[1])
    margin = 0.06 * (high - low) or 0.5
    return low - margin, high + margin


def _place_points(shot: Shot) -> NDArray[np.float32]:
    """Return the coordinates in the scan's frame, (3, N), in float32 like in the projection."""
    points = np.stack([shot.columns[axis] for axis in "xyz"], axis=1)
    rigid = shot.place.target_from_source
    return np.ascontiguousarray((points if rigid is None else rigid.apply(points)).T)
