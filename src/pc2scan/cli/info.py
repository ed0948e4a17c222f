"""``pc2scan info``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import stamp_text

from .damage import show_damage
from .info_scans import show_scans
from .options import Json, StaticTf, TfSources
from .render import count, print_json, printable, size, table, warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.inspect.info import CloudInfo, Info
    from pc2scan.tf.mounting import Mounting

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
    target_frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME", help="Show heights in this frame, as convert --target-frame sees them.", show_default=False
        ),
    ] = "",
    static_tf: StaticTf = [],  # noqa: B006 - typer reads the default and never hands it out
    *,
    transforms: TfSources,
    source_frame: Annotated[
        str,
        typer.Option(metavar="FRAME", help="Frame of the clouds, where their own is wrong.", show_default=False),
    ] = "",
    as_json: Json = False,
) -> None:
    """Show what is in a recording, its clouds and its scans.

    For each PointCloud2 topic: fields, points, frame, NaN, the spread of x, y, z and range, and a histogram
    of heights, since heights are what conversions get wrong. For each LaserScan topic: beams, sector and increment,
    limits, the share of returns, and which consumers would take them. Then where floor and ceiling are, whether the
    clouds are tilted, upside down or in a camera's optical frame, and the convert command that suits them.
    """
    from pc2scan.inspect.info import info as look
    from pc2scan.tf.options import FrameOptions, StaticTransform

    frames = FrameOptions(
        tf_topics=tuple(transforms.tf_topic),
        tf_from=tuple(transforms.tf_from),
        static=tuple(StaticTransform.parse(text) for text in static_tf),
        source_frame=source_frame,
    )
    result = look(sources, samples=samples, target_frame=target_frame, frames=frames)
    given = [
        *(word for topic in transforms.tf_topic for word in ("--tf-topic", topic)),
        *(word for path in transforms.tf_from for word in ("--tf-from", str(path))),
        *(word for text in static_tf for word in ("--static-tf", text)),
        *(("--source-frame", source_frame) if source_frame else ()),
    ]
    if as_json:
        print_json(result.as_dict())
    else:
        _show(result)
        _show_findings(result, given)
    show_damage(result.damage)
    for warning in result.warnings:
        warn(warning)
    for cloud in result.clouds:
        if cloud.mounting is not None and cloud.mounting.warning:
            warn(cloud.mounting.warning)


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


def _show_findings(result: Info, given: Sequence[str]) -> None:
    """Say where floor and ceiling are, and with which command each topic is converted."""
    found = [(cloud.topic, cloud.mounting) for cloud in result.clouds if cloud.mounting is not None]
    if not any(mounting.heights for _, mounting in found):
        return
    typer.echo()
    for topic, mounting in found:
        typer.echo(printable(f"{topic}: {_ground_text(mounting)}"))
    typer.echo("\nready to convert:")
    for topic, mounting in found:
        if mounting.heights is not None:
            typer.echo(printable(f"  {shlex.join(_command(result, topic, mounting, given))}"))


def _ground_text(mounting: Mounting) -> str:
    ground, heights = mounting.ground, mounting.heights
    if heights is None or heights.floor is None:
        return "no floor seen, heights are those of most points"
    frame = mounting.target_frame or mounting.judged_in
    ceiling = "" if heights.ceiling is None else f", ceiling at {heights.ceiling:.2f} m"
    floor = round(heights.floor, 2) + 0.0
    sensor = "" if ground.height is None else f"; the sensor is {ground.height:.2f} m above the floor"
    return f"floor at z = {floor:.2f} m in frame {frame!r}{ceiling}{sensor}"


def _command(result: Info, topic: str, mounting: Mounting, given: Sequence[str]) -> list[str]:
    """The conversion of a topic's clouds: heights that suit it, in a frame that is level."""
    heights = mounting.heights
    assert heights is not None  # asked for only where they are known
    target = mounting.target_frame or (mounting.judged_in if mounting.judged_in != mounting.frame else "")
    names = {other.topic for other in result.topics}
    single = len(result.clouds) == 1
    words = ["pc2scan", "convert", *(file.path for file in result.files)]
    if not single or "/scan" in names:
        words += ["--topic", f"{topic}:={topic.rstrip('/')}/scan" if "/scan" in names else topic]
    words += given
    words += ["--static-tf", mounting.static_tf] if mounting.static_tf else []
    words += ["--target-frame", target] if target else []
    # A word that begins with a minus needs no sign of equality: no option has a digit behind it.
    return [*words, "--min-height", f"{heights.low:g}", "--max-height", f"{heights.high:g}"]


def _show_heights(cloud: CloudInfo) -> None:
    if not cloud.height_counts:
        return
    where = f" in {cloud.target_frame}" if cloud.target_frame else ""
    typer.echo()
    typer.echo(printable(f"  heights (z){where}"))
    most, total = max(cloud.height_counts), sum(cloud.height_counts)
    edges = list(zip(cloud.height_edges, cloud.height_edges[1:], strict=False))
    for (low, high), points in reversed(list(zip(edges, cloud.height_counts, strict=True))):
        bar = "#" * round(_BAR * points / most)
        typer.echo(f"  {low:9.2f} to {high:8.2f} m {points / total:6.1%} {bar}")
