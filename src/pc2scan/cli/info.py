"""``pc2scan info``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import leading
from pc2scan.options.call import Options

from .damage import show_damage
from .render import print_json, say, show_parts, warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.inspect.info import Info
    from pc2scan.tf.mounting import Mounting


def info(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings; several are merged in time order."),
    ],
    *,
    options: Options,
) -> None:
    """Describe a recording, its clouds and its scans.

    For each PointCloud2 topic, it shows fields, points, frame, NaN, the spread of x, y, z and range, and a histogram of
    heights, which helps to choose --min-height and --max-height. For each LaserScan topic: beams, sector and
    increment, limits, the share of returns, and the consumers that accept them. Then the heights of floor and ceiling,
    whether the clouds are tilted, upside down or in a camera's optical frame, and a convert command for them.
    """
    from pc2scan.inspect.info import info as look
    from pc2scan.options.frames import frames_of

    target_frame, frames = options.target_frame, frames_of(options)
    result = look(sources, samples=options.samples, target_frame=target_frame, frames=frames)
    given = [
        *(word for topic in frames.tf_topics for word in ("--tf-topic", topic)),
        *(word for path in frames.tf_from for word in ("--tf-from", str(path))),
        *(word for text in options.static_tf for word in ("--static-tf", text)),
        *(("--source-frame", frames.source_frame) if frames.source_frame else ()),
    ]
    if options.as_json:
        print_json(result.as_dict())
    else:
        show_parts(result.overview())
        _show_findings(result, given)
    show_damage(result.damage)
    for warning in result.warnings:
        warn(warning)
    for cloud in result.clouds:
        if cloud.mounting is not None and cloud.mounting.warning:
            warn(cloud.mounting.warning)
    if target_frame and result.clouds and all(cloud.problems and cloud.x is None for cloud in result.clouds):
        # What was asked for is not shown.
        raise typer.Exit(1)


def _show_findings(result: Info, given: Sequence[str]) -> None:
    """Show the heights of floor and ceiling, and a command that converts each topic."""
    from pc2scan.inspect.info import ground_text

    found = [(cloud.topic, cloud.mounting) for cloud in result.clouds if cloud.mounting is not None]
    if not any(mounting.heights for _, mounting in found):
        return
    say()
    for topic, mounting in found:
        say(f"{leading(topic)}: {ground_text(mounting)}")
    say()
    say("ready to convert:")
    for topic, mounting in found:
        if mounting.heights is not None:
            say(f"  {shlex.join(_command(result, topic, mounting, given))}")


def _command(result: Info, topic: str, mounting: Mounting, given: Sequence[str]) -> list[str]:
    """Return a command that converts a topic's clouds, with heights that suit it, in a level frame."""
    from pc2scan.tf.mounting import sensor_exclusion

    heights = mounting.heights
    assert heights is not None  # called only if they are known
    target = mounting.target_frame or (mounting.judged_in if mounting.judged_in != mounting.frame else "")
    names = {other.topic for other in result.topics}
    single = len(result.clouds) == 1
    words = ["pc2scan", "convert", *(file.path for file in result.files)]
    if not single or "/scan" in names:
        words += ["--topic", f"{topic}:={topic.rstrip('/')}/scan" if "/scan" in names else topic]
    words += given
    words += ["--static-tf", mounting.static_tf] if mounting.static_tf else []
    words += ["--target-frame", target] if target else []
    # Negative numbers need no "=" between option and value, because no option begins with a digit.
    words += ["--min-height", f"{heights.low:g}", "--max-height", f"{heights.high:g}"]
    if next(cloud.zero_share for cloud in result.clouds if cloud.topic == topic):
        option, value = sensor_exclusion(mounting.frame, target)
        words += [f"--{option.replace('_', '-')}", value]
    return words
