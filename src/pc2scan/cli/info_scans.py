"""The scans of a topic, as ``pc2scan info`` shows them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import typer

from .render import printable, table

if TYPE_CHECKING:
    from pc2scan.inspect.scan_info import ScanInfo

__all__ = ["show_scans"]


def show_scans(scans: ScanInfo) -> None:
    """Show what the scans of one topic look like."""
    typer.echo(printable(f"{scans.topic}: {scans.sampled} scans sampled"))
    for problem in scans.problems:
        typer.echo(printable(f"  cannot be decoded: {problem}"))
    if scans.angle_min is None or scans.angle_max is None or scans.angle_increment is None:
        return
    beams = f"{scans.beams_min:,}" + (f" to {scans.beams_max:,}" if scans.beams_max > scans.beams_min else "")
    degrees = [math.degrees(angle) for angle in (scans.angle_min, scans.angle_max, scans.angle_increment)]
    typer.echo(printable(f"  frame   {', '.join(repr(frame) for frame in scans.frames)}"))
    typer.echo(f"  beams   {beams}, {degrees[0]:.2f} to {degrees[1]:.2f} deg by {degrees[2]:.4f} deg")
    typer.echo(f"          ({scans.angle_min:.6g} to {scans.angle_max:.6g} rad by {scans.angle_increment:.6g})")
    typer.echo(
        f"  limits  {scans.range_min:.4g} to {scans.range_max:.4g} m; scan_time {scans.scan_time:.4g} s, "
        f"time_increment {scans.time_increment:.4g} s"
    )
    empty = f"; {scans.empty} of {scans.sampled} scans have none" if scans.empty else ""
    typer.echo(
        f"  returns {scans.return_share:.1%} of the beams{empty}; {'with' if scans.intensities else 'no'} intensities"
    )
    others = [
        (scans.infinite_share, "inf"),
        (scans.nan_share, "NaN"),
        (scans.short_share, "below range_min"),
        (scans.long_share, "above range_max"),
    ]
    if any(share for share, _ in others):
        typer.echo("          " + ", ".join(f"{name} {share:.1%}" for share, name in others if share))
    if scans.range is not None:
        typer.echo()
        spread = scans.range
        table(
            ("[m]", "min", "5%", "median", "95%", "max"),
            [("range", *(f"{v:.3f}" for v in (spread.min, spread.p5, spread.median, spread.p95, spread.max)))],
            left=("[m]",),
        )
    _show_consumers(scans)


def _show_consumers(scans: ScanInfo) -> None:
    outcomes: dict[str, list[str]] = {}
    for consumer, outcome in scans.consumers:
        outcomes.setdefault(outcome, []).append(consumer)
    typer.echo("\n  consumers")
    for name, consumers in outcomes.items():
        typer.echo(f"  {name:<10}{', '.join(consumers)}")
    typer.echo("  pc2scan check says why, and looks at all scans and their transforms")
