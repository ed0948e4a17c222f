"""``pc2scan info``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import stamp_text

from .damage import show_damage
from .info_scans import show_scans
from .options import Json
from .render import count, print_json, printable, size, table

if TYPE_CHECKING:
    from pc2scan.inspect.info import CloudInfo, Info

__all__ = ["info"]

_BAR = 40


def info(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings; several are one, merged in time order."),
    ],
    samples: Annotated[
        int, typer.Option(min=1, help="Clouds and scans of each topic to look at, spread over the recording.")
    ] = 10,
    as_json: Json = False,
) -> None:
    """Show what is in a recording, its clouds and its scans.

    For each PointCloud2 topic: fields, points, frame, NaN, the spread of x, y, z and range, and a histogram
    of heights, since heights are what conversions get wrong. For each LaserScan topic: beams, sector and increment,
    limits, the share of returns, and which consumers would take them.
    """
    from pc2scan.inspect.info import info as look

    result = look(sources, samples=samples)
    if as_json:
        print_json(result.as_dict())
    else:
        _show(result)
    show_damage(result.damage)


def _show(result: Info) -> None:
    for file in result.files:
        kind = " ".join(filter(None, (file.container, file.storage, file.profile)))
        typer.echo(printable(f"{file.path}: {kind}, {'+'.join(file.compression) or 'empty'}, {size(file.size_bytes)}"))
    if result.start_ns is not None and result.end_ns is not None:
        typer.echo(
            f"from {stamp_text(result.start_ns)} to {stamp_text(result.end_ns)}: "
            f"{result.duration_ns / 1e9:.3f} s, {result.messages:,} messages"
        )
    else:
        typer.echo("no messages")
    typer.echo()
    table(
        ("topic", "type", "messages", "Hz", "publishers", ""),
        [
            (
                topic.topic,
                topic.msgtype + ("" if topic.serialization in ("ros1", "cdr") else f" ({topic.serialization})"),
                count(topic.messages),
                "-" if topic.rate_hz is None else f"{topic.rate_hz:.2f}",
                f"{topic.connections}",
                "latched" if topic.latched else "",
            )
            for topic in result.topics
        ],
        left=("topic", "type", ""),
    )
    for cloud in result.clouds:
        typer.echo()
        _show_cloud(cloud)
    for scan in result.scans:
        typer.echo()
        show_scans(scan)


def _show_cloud(cloud: CloudInfo) -> None:
    typer.echo(printable(f"{cloud.topic}: {cloud.sampled} clouds sampled"))
    for problem in cloud.problems:
        typer.echo(printable(f"  cannot be decoded: {problem}"))
    if not cloud.fields:
        return
    points = f"{cloud.points_min:,}" + (f" to {cloud.points_max:,}" if cloud.points_max > cloud.points_min else "")
    height, width = cloud.shape
    typer.echo(printable(f"  frame   {', '.join(repr(frame) for frame in cloud.frames)}"))
    is_laid_out = cloud.point_step > 0
    each = f", {cloud.point_step} bytes each" if is_laid_out else ""
    typer.echo(f"  points  {points} a cloud ({height} x {width}){each}")
    fields = [f"{name} {kind}" + (f" @{offset}" if is_laid_out else "") for name, kind, offset in cloud.fields]
    typer.echo(printable(f"  fields  {', '.join(fields)}"))
    typer.echo(f"  NaN {cloud.nan_share:.1%}, (0, 0, 0) {cloud.zero_share:.1%}, z > 0 {cloud.above_zero_share:.1%}")
    spreads = [(name, spread) for name in ("x", "y", "z", "range") if (spread := getattr(cloud, name)) is not None]
    if spreads:
        typer.echo()
        table(
            ("[m]", "min", "5%", "median", "95%", "max"),
            [(name, *(f"{value:.3f}" for value in (s.min, s.p5, s.median, s.p95, s.max))) for name, s in spreads],
            left=("[m]",),
        )
    _show_heights(cloud)


def _show_heights(cloud: CloudInfo) -> None:
    if not cloud.height_counts:
        return
    typer.echo("\n  heights (z)")
    most, total = max(cloud.height_counts), sum(cloud.height_counts)
    edges = list(zip(cloud.height_edges, cloud.height_edges[1:], strict=False))
    for (low, high), points in reversed(list(zip(edges, cloud.height_counts, strict=True))):
        bar = "#" * round(_BAR * points / most)
        typer.echo(f"  {low:9.2f} to {high:8.2f} m {points / total:6.1%} {bar}")
