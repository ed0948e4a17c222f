"""Judges the first clouds of a topic, which were converted before anything is written, by the checks."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.rule import PointCounts
from pc2scan.core.scene import JUDGED_CLOUDS, PARTS, WHOLE_POINTS, CloudSample, gathered

from .checks import EACH_CLOUD, FIRST_CLOUDS, FIRST_CLOUDS_NOTES, FRAME, found_by
from .checks.clouds import CloudFacts, KnownTransforms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.request.options import ScanSpec


class FirstCloud(NamedTuple):
    """One of the first clouds of a topic: a sample in the frame of its scan, and what became of its points."""

    sample: CloudSample
    counts: PointCounts


class Judgement(NamedTuple):
    """What the first clouds of a topic show.

    Attributes
    ----------
    warnings, notes
        Texts for the user.
    advice
        Options with heights that suit the clouds; empty if none are needed.
    no_returns
        The share of points that are outside the heights, and no returns.
    """

    warnings: Sequence[str]
    notes: Sequence[str] = ()
    advice: str = ""
    no_returns: float = 0.0


def are_enough(topic: str, spec: ScanSpec, clouds: Sequence[FirstCloud], known: KnownTransforms) -> bool:
    """Whether no more clouds are needed for a judgement: a level floor in the first one leaves no doubt."""
    if clouds and len(clouds[0].sample.points) < WHOLE_POINTS:
        return len(clouds) >= PARTS
    with np.errstate(all="ignore"):
        if len(clouds) != 1:
            return len(clouds) >= JUDGED_CLOUDS
        facts = _facts(topic, spec, clouds, known)
        return facts.are_fine and not found_by(FIRST_CLOUDS, facts)


def judge(topic: str, spec: ScanSpec, clouds: Sequence[FirstCloud], known: KnownTransforms) -> Judgement:
    """Return what the first clouds of a topic, one at least, show for one output."""
    seen = [_facts(topic, spec, clouds[:number], known) for number in range(1, len(clouds) + 1)]
    facts, label = _facts(topic, spec, _together(clouds), known), spec.label
    warnings = [text for each in seen for text in found_by(EACH_CLOUD, each, label)]
    no_returns = 0.0
    with np.errstate(all="ignore"):
        if any(cloud.sample.zeros for cloud in clouds):
            no_returns = facts.no_returns / max(facts.total.total, 1)
        findings = found_by(FIRST_CLOUDS, facts, label)
        if facts.are_fine and not findings:
            return Judgement(warnings, no_returns=no_returns)
        warnings += (*found_by(FRAME, facts), *findings)
        return Judgement(warnings, found_by(FIRST_CLOUDS_NOTES, facts, label), facts.advice, no_returns)


def _together(clouds: Sequence[FirstCloud]) -> Sequence[FirstCloud]:
    """Return the clouds, with those that are parts of a turn or of a pattern as one."""
    samples = gathered([each.sample for each in clouds])
    if len(samples) == len(clouds):
        return clouds
    return [FirstCloud(samples[0], sum((each.counts for each in clouds), PointCounts()))]


def _facts(topic: str, spec: ScanSpec, clouds: Sequence[FirstCloud], known: KnownTransforms) -> CloudFacts:
    return CloudFacts(topic, spec, known, [each.sample for each in clouds], [each.counts for each in clouds])
