"""The routes of a conversion: what is done with each connection's messages, and the topics that the results go to."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.messages.clouds import written_as_pointcloud2
from pc2scan.messages.pointcloud2 import POINTCLOUD2

from .items import OpenRoute, Output
from .report import TopicReport
from .steps import steps_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pc2scan.bags.reader import Reader
    from pc2scan.request.options import ScanSpec

    from .combine.combiner import Combiner
    from .declarations import RecordingTopics
    from .plan import Combination, Route, RouteTask
    from .steps import Conversion, ConvertedMessage, Step


class Routes(NamedTuple):
    """The routes of a conversion.

    Attributes
    ----------
    by_id
        By the id of their connection.
    entries
        The report's entries of their topics.
    combiners
        What makes scans of several messages, by the outputs of these messages.
    """

    by_id: dict[int, OpenRoute]
    entries: list[TopicReport]
    combiners: dict[Output, Combiner]


def open_routes(
    routes: Iterable[Route],
    conversions: Mapping[ScanSpec | Combination, Conversion],
    topics: RecordingTopics | None = None,
    last: Callable[[str, ConvertedMessage], ConvertedMessage] | None = None,
) -> Routes:
    """Prepare the work on the messages of each connection.

    Parameters
    ----------
    routes
        The plan.
    conversions
        The conversion of each output.
    topics
        The topics of the recording that results are written to: the last step serialises these. None: no message passes
        as it is.
    last
        Without a recording, the last step: takes the serialisation of the source and a result.
    """
    opening = _Opening(topics)
    opened: dict[int, OpenRoute] = {}
    for route in routes:
        if topics is None and not route.tasks:
            continue
        connection = route.connection
        made = opened[connection.id] = OpenRoute(connection)
        passing = None
        if route.passes and topics is not None:
            passing = TopicReport(connection.topic, connection.ros_type, connection.topic, "passed")
            made.passing_handle, made.reencode = topics.add_passing(connection, passing)
            made.unpacks = topics.as_pointcloud2 and written_as_pointcloud2(connection)
        if not route.tasks:
            made.report = opening.shared(passing or TopicReport(connection.topic, connection.ros_type, None, "skipped"))
            continue
        chosen = [conversions[task.combination or task.spec] for task in route.tasks]
        if last is None:
            assert topics is not None  # either is given
            steps = [partial(conversion.serialise, topics.target.serialization) for conversion in chosen]
        else:
            steps = [partial(last, connection.serialization)] * len(chosen)
        combiners = [
            None if task.combination is None else opening.combiner_of(task.combination, conversion, step)
            for task, conversion, step in zip(route.tasks, chosen, steps, strict=True)
        ]
        # A group has the last step, not its messages.
        own_steps = [None if combiner else step for step, combiner in zip(steps, combiners, strict=True)]
        made.steps = steps_of(chosen, connection.topic, connection.serialization, connection.ros_type, own_steps)
        if not made.unpacks:
            made.shrinks_from = sum(conversion.shrinks_from for conversion in chosen)
        for index, (task, conversion, combiner) in enumerate(zip(route.tasks, chosen, combiners, strict=True)):
            opening.add_outputs(made, index, task, conversion.made_type, combiner, passing)
    return Routes(opened, list(opening.entries.values()), opening.by_output)


class _Opening:
    """What the routes of a conversion share.

    Attributes
    ----------
    entries
        The report's entries: publishers of one topic share one if their messages are handled alike.
    by_output
        What makes scans of several messages, by the outputs of these.
    """

    def __init__(self, topics: RecordingTopics | None) -> None:
        self._topics = topics
        self._combiners: dict[Combination, Combiner] = {}
        self.entries: dict[tuple[object, ...], TopicReport] = {}
        self.by_output: dict[Output, Combiner] = {}

    def shared(self, entry: TopicReport) -> TopicReport:
        """Return the report's entry."""
        key = (entry.topic, entry.msgtype, entry.target, entry.action, entry.note, entry.spec)
        return self.entries.setdefault(key, entry)

    def combiner_of(self, combination: Combination, conversion: Conversion, last: Step) -> Combiner | None:
        """Return what makes one scan of several messages; all routes of a combination share it."""
        from .combine.combiner import Combiner  # noqa: PLC0415
        from .combine.conversion import MessagesToScan  # noqa: PLC0415  # few scans are made of several messages

        if not isinstance(conversion, MessagesToScan) or conversion.grouper is None:
            return None
        if combination not in self._combiners:
            self._combiners[combination] = Combiner(conversion, last)
        return self._combiners[combination]

    def add_outputs(
        self,
        made: OpenRoute,
        index: int,
        task: RouteTask,
        made_type: str,
        combiner: Combiner | None,
        passing: TopicReport | None,
    ) -> None:
        """Add the topics that the results of a task go to."""
        connection, topics, combination = made.connection, self._topics, task.combination
        topic, msgtype = connection.topic, connection.ros_type
        leads = combination is None or combination.sources[0] == topic
        action = "converted" if leads else "joined"
        for name in task.targets:
            entry = TopicReport(topic, msgtype, name, action, clouds_kept=made.passing_handle >= 0, spec=task.spec)
            if passing is not None and passing.lost:
                entry.note, entry.lost = passing.note, True
            output = Output(self.shared(entry), index)
            if leads and topics is not None:
                output.handle = topics.add_like(connection, name, made_type)
            made.outputs.append(output)
            if combiner is not None and combination is not None:
                self.by_output[output] = combiner
                combiner.reports[combination.sources.index(topic)] = output.report
        if (name := task.spec.keep_used) and leads and topics is not None:
            note = f"the points that the beams of {', '.join(task.targets)} read"
            points = Output(self.shared(TopicReport(topic, msgtype, name, "added", note)), index, used=True)
            points.handle = topics.add_like(connection, name, POINTCLOUD2)
            made.outputs[-1].points = points
            made.outputs.append(points)


def count_skipped(
    routes: Mapping[int, OpenRoute], reader: Reader, start_ns: int | None, stop_ns: int | None
) -> dict[int, OpenRoute]:
    """Count the messages of routes that write nothing, if the source's index has their numbers.

    Returns
    -------
    dict[int, OpenRoute]
        All other routes: those that write, and those whose messages must be read to be counted.
    """
    skipped = [route for route in routes.values() if not route.writes]
    counted = reader.counts([route.connection for route in skipped], start_ns, stop_ns) if skipped else {}
    # What was latched before the cut would have been written, too.
    lasting = [route.connection for route in skipped if route.connection.is_latched]
    earlier = reader.counts(lasting, None, start_ns) if lasting and start_ns is not None else {}
    for route in skipped:
        (entry,) = route.reports
        before = earlier.get(route.connection.id, 0)
        entry.skip(counted.get(route.connection.id, 0) + (before if route.connection.is_static else min(before, 1)))
    return {key: route for key, route in routes.items() if key not in counted}
