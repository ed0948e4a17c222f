"""The table of checks of requests and first clouds: each reads facts of one kind, and yields warnings with their cure.

A check is a function of its group's facts, and yields its warnings, or nothing. It changes nothing. A new one is a
function, a line in this table, and a row in a test. Users see the warnings of a group in the order of the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from . import clouds, request
from .request import OutputRequest

if TYPE_CHECKING:
    from pc2scan.model import Summary
    from pc2scan.request.options import ConvertOptions

    from .clouds import CloudFacts

Facts = TypeVar("Facts")
Checks: TypeAlias = tuple[Callable[[Facts], Iterable[str]], ...]

#: What the request of an output says, before anything is read.
REQUEST: Checks[OutputRequest] = (
    request.unused_transforms,
    request.accumulated_without_motion,
    request.returns_without_object,
    request.times_in_another_unit,
    request.increment_in_degrees,
    request.beams_beyond_half_turn,
)

#: What each of the first clouds of a topic shows, at once.
EACH_CLOUD: Checks[CloudFacts] = (
    clouds.target_that_moves,
    clouds.clouds_in_fixed_frame,
    clouds.returns_at_sensor,
)

#: What the first clouds show about their frame, which all outputs share.
FRAME: Checks[CloudFacts] = (clouds.frame_not_level,)

#: What the first clouds show about the parameters of an output.
FIRST_CLOUDS: Checks[CloudFacts] = (
    clouds.lossy_clouds,
    clouds.swapped_transform,
    clouds.clouds_in_another_unit,
    clouds.nearly_empty_scans,
    clouds.floor_within_heights,
    clouds.ceiling_within_heights,
)
FIRST_CLOUDS_NOTES: Checks[CloudFacts] = (clouds.heights_left_to_user,)


def found_by(checks: Checks[Facts], facts: Facts, label: str = "") -> list[str]:
    """Return all that checks find, in their order; each text begins with the label of the output."""
    return [label + text for check in checks for text in check(facts)]


def request_warnings(options: ConvertOptions, recorded: Summary) -> list[str]:
    """Return the warnings about a request, of each output, and about the recording's extent."""
    warnings = [text for spec in options.scans for text in found_by(REQUEST, OutputRequest(options, spec), spec.label)]
    return [*warnings, *request.cut_in_another_unit(options, recorded), *request.log_times_of_centuries(recorded)]
