"""Measures the first messages of topics that become scans together: their periods, and whether they share a clock."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from pc2scan.advice.clocks import MEASURES, are_doubtful, logged_early
from pc2scan.advice.measurements import Measurements, ask_measurements, measure, require_fields, unknown_step
from pc2scan.core.percentiles import median_low
from pc2scan.core.timing import median_interval_ns
from pc2scan.errors import UsageError, name_list
from pc2scan.messages.clouds import SCANS

from .grouping import Grouper
from .rules import Interval, Nearest, Recent

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pc2scan.advice.survey import Header, TopicFacts
    from pc2scan.conversion.plan import Output
    from pc2scan.transforms.placing import Placer

    from .rules import Rule

#: How many messages of a topic are read to measure its period, and to compare its clock.
_HEADERS = 6

#: Half a period, nanoseconds, for topics without two different stamps.
_HALF_PERIOD_NS = 50_000_000

#: Two topics have different clocks if the delays from their stamps to their log times differ by this.
_SURELY_ANOTHER_NS = 2_000_000_000

#: A window of more periods was probably meant in milliseconds; so are seconds of more messages in one scan.
_MOST_PERIODS = 5
_MOST_MESSAGES = 300

#: The fields that the beams of a LaserScan have.
_BEAM_FIELDS = ("x", "y", "z", "intensity", "index")


class SourceFacts:
    """What the messages of topics that become scans together show.

    Parameters
    ----------
    output
        The request, and the topics.
    facts
        Of each topic.

    Raises
    ------
    ParameterError
        If a field is requested that the beams of LaserScans do not have.
    """

    def __init__(self, output: Output, facts: Mapping[str, TopicFacts]) -> None:
        self.output, self.facts = output, facts
        spec, topics = output.spec, output.sources
        asked, params = spec.combining, spec.params
        self.flat = [topic for topic in topics if any(each.ros_type in SCANS for each in facts[topic].connections)]
        self._is_compared = bool(
            len(topics) > 1
            or asked.every_ns
            or asked.span_ns
            or (self.flat and "auto" in (params.scan_time, params.beams))
        )
        if spec.needs_measuring:
            for each in facts.values():
                ask_measurements(each, spec)
        if self._is_compared:
            for each in facts.values():
                each.ask_headers(_HEADERS)

    def firsts(self, topic: str) -> Sequence[Header]:
        """Return the first headers of a topic; none if they are not needed."""
        return self.facts[topic].headers[:_HEADERS] if self._is_compared else ()

    def period_ns(self, topic: str) -> int | None:
        """Return the median interval of the first stamps of a topic."""
        return median_interval_ns(each.stamp_ns for each in self.firsts(topic))

    def delays(self, topic: str, lead: str) -> tuple[int, int] | None:
        """Return the median delays from stamps to log times of two topics, nanoseconds; None if one has no messages."""
        own, other = ([each.delay_ns for each in self.firsts(name)] for name in (topic, lead))
        return (median_low(own), median_low(other)) if own and other else None


def _surely_differ(one_ns: int, other_ns: int) -> bool:
    return abs(one_ns - other_ns) > _SURELY_ANOTHER_NS


def measure_sources(
    sources: SourceFacts, placer: Placer
) -> tuple[Measurements, Callable[[], Grouper] | None, list[str], list[str]]:
    """Measure what scans of several messages need.

    Parameters
    ----------
    sources
        What was observed of its messages.

    Returns
    -------
    Measurements
        The measurements of the leading topic.
    callable
        Makes the grouper of messages; None: each message becomes a scan by itself.
    list of str, list of str
        Notes and warnings.

    Raises
    ------
    ParameterError
        If a field is missing, or a parameter that is ``auto`` cannot be measured.
    UsageError
        If the stamps of the topics are of different clocks.
    """
    output = sources.output
    spec, topics = output.spec, output.sources
    asked, lead = spec.combining, topics[0]
    notes: list[str] = []
    timing: Mapping[str, Measurements] = {}
    if spec.needs_measuring:
        clouds = [facts for topic, facts in sources.facts.items() if topic not in sources.flat]
        timing, notes = measure(clouds, spec, placer)
        notes = [note for note in notes if note.startswith(f"{lead}: ")]
    if sources.flat:
        there = "the beams of a LaserScan have intensity, index, x and y"
        require_fields(spec, _BEAM_FIELDS, f"the scans on {name_list(sources.flat)}", lambda _: there)
    found = timing.get(lead) or _of_scans(sources, notes)
    if asked.every_ns and (spec.params.scan_time == "auto" or spec.origins.get("scan_time", "default") == "default"):
        found = Measurements(asked.every_ns / 1e9, found.time_increment, 0, found.azimuth_step)
    warnings = _doubtful(sources)
    grouper: Callable[[], Grouper]
    if asked.accumulates:
        # The first message is in the middle of an interval: near its edge, jitter would move messages to the next.
        half_ns = (sources.period_ns(lead) or 0) // 2
        rule: Rule = Recent(asked.every_ns, half_ns, asked.span_ns, asked.count)
        if not (asked.span_ns or asked.count):
            rule = Interval(asked.every_ns, half_ns)
        grouper = partial(Grouper, rule, len(topics))
        return found, grouper, notes, [*warnings, *_clocks(sources, None)]
    if len(topics) == 1:
        return found, None, notes, warnings
    windows = _windows(sources, asked.window_ns)
    warnings += _clocks(sources, windows)
    joined = ", ".join(
        f"{topic} (within {window / 1e9:.4g} s)" for topic, window in zip(topics[1:], windows[1:], strict=True)
    )
    notes.append(f"{output.target}: has the stamps of {lead}, and the nearest messages of {joined}")
    grouper = partial(Grouper, Nearest(windows_ns=tuple(windows)), len(topics), apart_ns=asked.window_ns or 0)
    return found, grouper, notes, warnings


def _doubtful(sources: SourceFacts) -> list[str]:
    """Return warnings of times that were probably meant in milliseconds, or as a number of clouds."""
    asked, topics = sources.output.spec.combining, sources.output.sources
    period_ns = sources.period_ns(topics[0])
    found = []
    for name, value_ns in (("every", asked.every_ns), ("accumulate", asked.span_ns), ("window", asked.window_ns or 0)):
        most, seconds = _MOST_PERIODS if name == "window" else _MOST_MESSAGES, value_ns / 1e9
        if seconds < 1 or not period_ns:
            continue
        meant = [f"milliseconds were meant: `{name}={seconds:g}ms`"] if value_ns > most * period_ns else []
        if name == "accumulate" and asked.is_bare and value_ns > period_ns:
            meant.append(f"clouds were meant: `{name}={seconds:g}clouds`")
        if meant:
            every = f"messages of {topics[0]} come every {period_ns / 1e9:.3g} s"
            found.append(f"`{name}` is {seconds:g} s, but {every}; if {', if '.join(meant)}")
    return found


def _windows(sources: SourceFacts, window_ns: int | None) -> list[int]:
    """Return the window of each topic: half its own period or half the leading topic's, whichever is longer."""
    topics = sources.output.sources
    if window_ns is not None:
        return [window_ns] * len(topics)
    periods = [sources.period_ns(topic) or 2 * _HALF_PERIOD_NS for topic in topics]
    return [max(period, periods[0]) // 2 for period in periods]


def _clocks(sources: SourceFacts, windows: Sequence[int] | None) -> list[str]:
    """Compare the clocks of the topics: return warnings if they may differ, and raise if they do."""
    warnings = []
    lead, *others = sources.output.sources
    for number, topic in enumerate(others, 1):
        delays = sources.delays(topic, lead)
        if delays is None:
            continue
        own_ns, lead_ns = delays
        behind_ns = own_ns - lead_ns
        if not are_doubtful(own_ns, lead_ns, 0 if windows is None else windows[number]):
            continue
        how = f"{abs(behind_ns) / 1e9:.4g} s {'behind' if behind_ns > 0 else 'ahead of'}"
        said = f"the stamps of {topic} are {how} those of {lead}, compared with their log times"
        if _surely_differ(own_ns, lead_ns):
            raise UsageError(
                f"{said}: they are of different clocks",
                hint=f"{MEASURES}; or convert them to scans of their own: `topics={topic}:=/scan_2`",
            )
        if logged_early(own_ns, lead_ns):
            which = topic if behind_ns < 0 else lead
            early = f"messages of {which} are logged {-min(own_ns, lead_ns) / 1e9:.3g} s before their stamps"
            said += f": {early}, so their clocks differ, and a scan has what was measured that far apart"
        else:
            said += ": if their clocks differ, a scan has what was measured that far apart"
        warnings.append(f"{said}; {MEASURES}")
    return warnings


def _of_scans(sources: SourceFacts, notes: list[str]) -> Measurements:
    """Return the measurements of a leading topic that has LaserScans, or no messages."""
    params, topic = sources.output.spec.params, sources.output.sources[0]
    scan_time, step = params.scan_time, 0.0
    if scan_time == "auto":
        scan_time = (sources.period_ns(topic) or 0) / 1e9
        notes.append(f"{topic}: scan_time is {scan_time:.6g} s, the median interval of its first stamps")
    if params.beams == "auto":
        steps = [each.increment for each in sources.firsts(topic)]
        known = [each for each in steps if each is not None and 0 < each < math.inf]
        if not known:
            raise unknown_step(f"no scan on {topic} has an angle_increment")
        step = median_low(known)
        count = params.at_resolution(step).layout.count
        notes.append(f"{topic}: beams is {count:,}: the scans have one every {math.degrees(step):.4g} deg")
    return Measurements(scan_time, 0.0, 0, step)
