"""The times of points in the first clouds of each topic: checks them, or measures how a lidar without them turns."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.core.percentiles import median
from pc2scan.core.timing import IN_SECONDS, TIME_UNITS, increment_doubt, is_brief, median_interval_ns
from pc2scan.request.point_time import BY_AZIMUTH, TURN_CLOUDS, measure_turn, turn_sample

from .survey import Fact

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from pc2scan.core.points import Points
    from pc2scan.model import RawMessage
    from pc2scan.request.point_time import PointTime, Turn, TurnSample

    from .survey import TopicFacts

#: How many clouds of a topic are read, and how many stamps are needed to know its period.
_CLOUDS = 4
_FEWEST = 3

#: A cloud takes about the time from one stamp to the next. If it takes this many times as long, or this small a share
#: of it, and with another unit about as long, the unit is probably wrong.
_OFF = 50.0
_ABOUT = (0.2, 2.0)

#: Clocks probably differ if the points are measured this many periods, and this many seconds, from their stamp.
_PERIODS, _SECONDS = 2.0, 0.2


class PointTimes(NamedTuple):
    """The times of a cloud's points.

    Attributes
    ----------
    stamp_ns
        The cloud's stamp.
    field
        The field with the times.
    low, high
        Of the first and the last point, seconds after the stamp.
    unit
        Of the values, seconds.
    """

    stamp_ns: int
    field: str
    low: float
    high: float
    unit: float


def ask_times(facts: TopicFacts, point_time: PointTime) -> None:
    """Ask for the times of points: those of a field, or the turns of a lidar whose period is to be measured."""
    facts.ask_headers(_CLOUDS)
    if point_time.turn is None:
        facts.ask(times_of(point_time))
    elif not point_time.turn.period:
        facts.ask(TURNS)


def time_warnings(facts: TopicFacts, point_time: PointTime) -> Iterator[str]:
    """Yield warnings about times of points that are probably wrong, and would deskew a cloud wrongly.

    Times that are impossible are not among them: those are errors when their cloud is converted.
    """
    topic, clouds = facts.topic, [] if point_time.turn is not None else facts.found(times_of(point_time))
    if doubt := duration_warning(facts, point_time):
        yield doubt
        return
    period = (median_interval_ns(each.stamp_ns for each in clouds) or 0) / 1e9
    if len(clouds) < _FEWEST or not period:
        return
    low, high = median([each.low for each in clouds]), median([each.high for each in clouds])
    every = f"clouds come every {period:.3g} s"
    if max(low, -high) > max(_PERIODS * period, _SECONDS):
        where = "after" if low > 0 else "before"
        first, last = sorted((abs(low), abs(high)))
        yield (
            f"{topic}: the points are measured {first:.3g} to {last:.3g} s {where} the stamp of their cloud, by field "
            f"{clouds[0].field}, but {every}: if their clocks differ, deskewing moves the points wrongly; {BY_AZIMUTH}"
        )


def duration_warning(facts: TopicFacts, point_time: PointTime) -> str:
    """Return the warning that clouds or scans take far too long or too short by their own times; empty if not."""
    if any(each.turn for each in facts.headers):
        return increment_warning(facts)
    return "" if point_time.turn is not None else _duration_doubt(facts.topic, facts.found(times_of(point_time)))


def increment_warning(facts: TopicFacts) -> str:
    """Return the warning that scans take far too long or too short by their time_increment; empty if not."""
    turn = median([each.turn for each in facts.headers]) if facts.headers else 0.0
    period = (median_interval_ns(each.stamp_ns for each in facts.headers) or 0) / 1e9
    doubt = increment_doubt(turn, period) if turn else ""
    return f"{facts.topic}: {doubt}: {IN_SECONDS}" if doubt else ""


def times_of(point_time: PointTime) -> Fact[PointTimes]:
    """Return the fact: the times of points in a field."""
    return Fact(_times, _CLOUDS, (point_time,))


def _turn(points: Points, message: RawMessage) -> TurnSample:
    return turn_sample(points, message.log_time_ns)


#: What clouds show of how a lidar turns.
TURNS = Fact(_turn, TURN_CLOUDS)


def _times(points: Points, _: RawMessage, point_time: PointTime) -> PointTimes | None:
    """Return the times of a cloud's points; None if it has none."""
    known = point_time.read(points)
    low, high = known.low, known.high
    if known.measured - known.unknown < 2:
        return None
    return PointTimes(points.stamp_ns, known.field, low, high, known.unit)


def _duration_doubt(topic: str, clouds: Sequence[PointTimes]) -> str:
    period = (median_interval_ns(each.stamp_ns for each in clouds) or 0) / 1e9
    whole = median([each.high - each.low for each in clouds]) if len(clouds) >= _FEWEST else 0.0
    if not (period and whole > 0) or 1 / _OFF < whole / period < _OFF:
        return ""
    name, unit = clouds[0].field, clouds[0].unit
    takes = f"a cloud takes {whole:.3g} s, but clouds come every {period:.3g} s"
    likely = [other for other, size in TIME_UNITS.items() if _ABOUT[0] < whole / unit * size / period < _ABOUT[1]]
    used = next(other for other, size in TIME_UNITS.items() if size == unit)
    if likely:
        return (
            f"{topic}: the times of the points, field {name}, are taken for {used}: {takes}; "
            f"`point_time={name}:{likely[0]}`, if they are {likely[0]}"
        )
    if is_brief(whole, period):
        return (
            f"{topic}: the times of the points, field {name}, are in no unit that fits, as {used} {takes}: deskewing "
            f"hardly moves a point; `point_time=FIELD` names another field, and {BY_AZIMUTH}"
        )
    return ""


def measure_turns(topics: Iterable[TopicFacts], point_time: PointTime) -> tuple[dict[str, Turn], list[str]]:
    """Measure the rotation of the lidars, if the times of points come from azimuths and that of a turn is not given.

    Parameters
    ----------
    topics
        What was observed.
    point_time
        The source of the times.

    Returns
    -------
    dict, list of str
        The turn of each topic that has clouds, and notes for the user.

    Raises
    ------
    ParameterError
        If a turn cannot be measured in the first clouds of a topic.
    """
    turns: dict[str, Turn] = {}
    notes: list[str] = []
    if point_time.turn is not None and not point_time.turn.period:
        for facts in topics:
            if samples := facts.found(TURNS):
                turns[facts.topic], note = measure_turn(facts.topic, point_time.turn, samples)
                notes.append(note)
    return turns, notes
