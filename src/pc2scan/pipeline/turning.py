"""Measures in the first clouds of each topic how a lidar turns, if its points have no times."""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from typing import TYPE_CHECKING

from pc2scan.errors import MessageError
from pc2scan.messages.clouds import CLOUDS

from .stages.deskew import PointTime
from .stages.turn import FIRST_CLOUDS, Turn, look, measured_turn

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection


def measured_turns(
    reader: Reader,
    connections: Iterable[Connection],
    point_time: str,
    start_ns: int | None = None,
    stop_ns: int | None = None,
) -> tuple[dict[str, Turn], list[str]]:
    """Measure the rotation of the lidars, if points' times come from azimuths and the time of a turn is not given.

    Parameters
    ----------
    connections
        Those with clouds are used; others are ignored.
    point_time
        See `PointTime.parse`.
    start_ns, stop_ns
        The cut, by log time; None: no limit.

    Returns
    -------
    dict, list of str
        The turn of each topic that has clouds, and notes for the user.

    Raises
    ------
    ParameterError
        If a turn cannot be measured in the first clouds of a topic.
    """
    asked = PointTime.parse(point_time).turn if point_time else None
    if asked is None or asked.period:
        return {}, []
    topics: dict[str, list[Connection]] = {}
    for connection in connections:
        if connection.ros_type in CLOUDS:
            topics.setdefault(connection.topic, []).append(connection)
    turns: dict[str, Turn] = {}
    notes: list[str] = []
    for topic, sources in topics.items():
        decoders = {each.id: CLOUDS[each.ros_type](each.serialization) for each in sources}
        clouds = []
        with closing(reader.messages(sources, start_ns, stop_ns)) as messages:
            for message in islice(messages, FIRST_CLOUDS):
                try:
                    clouds.append(look(decoders[message.connection.id](message.data), message.log_time_ns))
                except MessageError:
                    # Messages that cannot be decoded are reported when they are converted.
                    continue
        if clouds:
            turns[topic], note = measured_turn(topic, asked, clouds)
            notes.append(note)
    return turns, notes
