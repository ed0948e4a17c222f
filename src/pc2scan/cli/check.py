"""``pc2scan check``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import stamp_text

from .damage import show_damage
from .options import Json, TfSources
from .render import message, print_json, printable, warn
from .spelling import as_typed

if TYPE_CHECKING:
    from pc2scan.inspect.check import Check, ConsumerCheck, TopicCheck

__all__ = ["check"]


class Consumer(StrEnum):
    """Those who read scans, as in `pc2scan.core.consumers.CONSUMERS`."""

    slam_toolbox = "slam_toolbox"
    cartographer = "cartographer"
    gmapping = "gmapping"
    amcl = "amcl"
    nav2 = "nav2"
    mrpt = "mrpt"


#: How many frames of a topic are named.
_SHOWN = 5


def check(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SRC...", help="Recordings with scans; several are one, merged in time order."),
    ],
    consumers: Annotated[
        list[Consumer],
        typer.Option(
            "--for",
            metavar="CONSUMER",
            help=f"Whose verdict makes the exit status: {', '.join(Consumer)}. Repeatable. "
            "Default: all, and general defects count too.",
        ),
    ] = [],  # noqa: B006 - typer reads the default and never hands it out
    topics: Annotated[
        list[str],
        typer.Option("--topic", "-t", metavar="TOPIC", help="LaserScan topic to look at. Repeatable. Default: all."),
    ] = [],  # noqa: B006
    odom_frame: Annotated[
        str, typer.Option(metavar="FRAME", help="The odometry's frame, which scans must be connected with.")
    ] = "odom",
    base_frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME",
            help="The robot's frame.  [default: base_link, or base_footprint]",
            show_default=False,
        ),
    ] = "",
    *,
    transforms: TfSources,
    as_json: Json = False,
) -> None:
    """Check whether SLAM and navigation would take a recording's scans.

    For each LaserScan topic and consumer: accepted; shifted (taken, but turned by up to one beam); misplaced (taken,
    but with beams or ranges where nothing is); ignored; or aborts (the consumer ends). With the rule, the numbers and
    the cure. Then what is wrong whoever reads the scans: frames and transforms, stamps, rates, lengths, ranges.
    Defects, or merely worth a notice.

    Exit status: 0 all accepted (without --for: or shifted, and no defect), 1 not, 2 wrong usage.
    """
    from pc2scan.inspect.check import check as look

    result = look(
        sources,
        consumers=[consumer.value for consumer in consumers],
        topics=topics,
        odom_frame=odom_frame,
        base_frame=base_frame,
        frames=transforms.options(),
    )
    if as_json:
        print_json(result.as_dict())
    else:
        for topic in result.topics:
            _show_topic(topic, result.asked)
        typer.echo(_conclusion(result))
        for warning in result.warnings:
            warn(warning)
    show_damage(result.damage)
    raise typer.Exit(result.exit_status)


def _show_topic(topic: TopicCheck, asked: tuple[str, ...]) -> None:
    typer.echo(printable(f"{topic.topic}: {_summary(topic)}"))
    if topic.first is not None:
        scan = topic.first
        typer.echo(
            f"  angles {scan.angle_min:.6g} to {scan.angle_max:.6g} rad by {scan.angle_increment:.6g}, "
            f"ranges {scan.range_min:.4g} to {scan.range_max:.4g} m"
        )
    typer.echo()
    for consumer in topic.consumers:
        if not asked or consumer.consumer in asked:
            _show_consumer(consumer, topic.scans)
    for finding in topic.findings:
        since = "" if finding.stamp_ns is None else f" (first at {stamp_text(finding.stamp_ns)})"
        typer.echo(message(f"  {finding.level}: {finding.text}{since}"))
        if finding.hint:
            typer.echo(message(f"          {finding.hint}"))
    typer.echo()


def _summary(topic: TopicCheck) -> str:
    low, high = topic.beams
    beams = f"{low:,}" if low == high else f"{low:,} to {high:,}"
    frames = ", ".join(repr(frame) for frame in topic.frames[:_SHOWN]) + (", ..." if topic.frames[_SHOWN:] else "")
    rate = "" if topic.interval_ns is None else f", {1e9 / topic.interval_ns:.2f} Hz"
    return f"{topic.scans:,} scans of {beams} beams{rate}, in frame {frames}" if topic.scans else "no scans"


def _show_consumer(consumer: ConsumerCheck, scans: int) -> None:
    share = "" if consumer.scans == scans else f" {consumer.scans:,} of {scans:,} scans"
    typer.echo(f"  {consumer.consumer:<14}{consumer.outcome}{share}")
    verdict = consumer.verdict
    if verdict.rule:
        typer.echo(f"      rule  {verdict.rule}")
        typer.echo(f"      here  {verdict.observed}; allowed: {verdict.allowed}")
        typer.echo(f"      cure  {as_typed(verdict.cure)}")


def _conclusion(result: Check) -> str:
    """Say in one line who would not take what, the worst first."""
    from pc2scan.core.consumers import OUTCOMES

    several = len(result.topics) > 1
    refusing: dict[str, dict[str, list[str]]] = {}
    for topic in result.topics:
        outcomes = {consumer.consumer: consumer.outcome for consumer in topic.consumers}
        for consumer in result.counting:
            outcome = outcomes.get(consumer, "nothing to take")
            if outcome != "accepted":
                refusing.setdefault(outcome, {}).setdefault(topic.topic, []).append(consumer)
    parts = [
        f"{outcome}{f' ({topic})' if several else ''}: {', '.join(consumers)}"
        for outcome in ("nothing to take", *reversed(OUTCOMES))
        for topic, consumers in refusing.get(outcome, {}).items()
    ]
    if result.defects:
        parts.append(f"{result.defects} defect{'s' if result.defects > 1 else ''}")
    if not parts:
        return f"ok: accepted by {', '.join(result.counting)}"
    return printable(f"{'not ok' if result.exit_status else 'ok'}; {'; '.join(parts)}")
