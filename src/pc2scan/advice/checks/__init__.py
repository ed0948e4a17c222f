"""Judges requests and first clouds by a table of checks: each reads facts of one kind, and yields warnings with cures.

A check is a function of its group's facts, and yields its warnings, or nothing. It changes nothing. A new one is a
function, a line in this table, and a row in a test. Users see the warnings of a group in the order of the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, TypeVar

import numpy as np

from . import first_clouds, plausibility
from .plausibility import OutputRequest

if TYPE_CHECKING:
    from pc2scan.model import Connection, Summary
    from pc2scan.request.spec import Request

    from .first_clouds import CloudFacts

Facts = TypeVar("Facts")
Checks: TypeAlias = tuple[Callable[[Facts], Iterable[str]], ...]

#: What the request of an output says, before anything is read; each check runs only if one of its options is given.
REQUEST: Mapping[Callable[[OutputRequest], Iterable[str]], set[str]] = {
    plausibility.unused_transforms: {"frames", "transform_tolerance"},
    plausibility.accumulated_without_motion: {"combining"},
    plausibility.returns_without_object: {"reduce"},
    plausibility.values_in_another_unit: {"transform_tolerance", "scan_time", "time_increment", "angle_increment"},
    plausibility.beams_beyond_half_turn: {"angle_min", "angle_max"},
}

#: What the first clouds of a topic show, each by itself.
EACH_CLOUD: Checks[CloudFacts] = (
    first_clouds.target_that_moves,
    first_clouds.clouds_in_fixed_frame,
    first_clouds.returns_at_sensor,
)

#: What the first clouds show about their frame, which all outputs share.
FRAME: Checks[CloudFacts] = (first_clouds.frame_not_level,)

#: What the first clouds show about the parameters of an output.
FIRST_CLOUDS: Checks[CloudFacts] = (
    first_clouds.lossy_clouds,
    first_clouds.clouds_in_another_unit,
    first_clouds.nearly_empty_scans,
    first_clouds.heights_above_floor,
    first_clouds.floor_within_heights,
    first_clouds.ceiling_within_heights,
)


def found_by(checks: Checks[Facts], facts: Facts, label: str = "") -> list[str]:
    """Return all that checks find, in their order; each text begins with the label of the output."""
    return [label + text for check in checks for text in check(facts)]


def request_warnings(request: Request, recorded: Summary, connections: Sequence[Connection]) -> list[str]:
    """Return the warnings about a request, of each output, and about the recording's extent."""
    warnings: list[str] = []
    for spec in request.scans:
        values = ((part, value) for part in (request, spec) for value in fields(part))
        chosen = {value.name for part, value in values if getattr(part, value.name) != value.default}
        chosen |= {name for name, origin in spec.origins.items() if origin != "default"}
        checks = tuple(check for check, names in REQUEST.items() if names & chosen)
        warnings += found_by(checks, OutputRequest(request, spec, connections), spec.label)
    if request.start or request.end:
        warnings += plausibility.cut_in_another_unit(request, recorded)
    return [*warnings, *plausibility.log_times_of_centuries(recorded)]


class Judgement(NamedTuple):
    """What the first clouds of a topic show.

    Attributes
    ----------
    warnings
        Texts for the user.
    advice
        Options with heights that suit the clouds; empty if none are needed.
    no_returns
        The share of points that are outside the heights, and no returns.
    is_level
        Whether a level floor is visible, and the heights suit it.
    """

    warnings: Sequence[str]
    advice: str = ""
    no_returns: float = 0.0
    is_level: bool = False


def judge(facts: CloudFacts) -> Judgement:
    """Return what the first clouds of a topic, one at least, show for one output."""
    label = facts.spec.label
    with np.errstate(all="ignore"):
        warnings = found_by(EACH_CLOUD, facts, label)
        facts = facts.gathered
        no_returns = facts.no_returns / max(facts.total.total, 1)
        findings = found_by(FIRST_CLOUDS, facts, label)
        if facts.are_fine and not findings:
            return Judgement(warnings, no_returns=no_returns, is_level=facts.is_level)
        warnings += (*found_by(FRAME, facts), *findings)
        return Judgement(warnings, facts.advice, no_returns)
