"""The routes of a conversion: what is done with each connection's messages, and the topics that the results go to."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.topics import is_static
from pc2scan.messages.pointcloud2 import POINTCLOUD2

from .conversion import converter
from .items import OpenRoute, Output
from .topic_report import TopicReport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection

    from .combine.combiner import Combiner
    from .conversion import Conversion, Step
    from .declarations import RecordingTopics
    from .plan import Combination, Route, RouteTask
    from .scan_spec import ScanSpec


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
    last: Callable[[Conversion, Connection], Step],
    recording: RecordingTopics | None = None,
) -> Routes:
    """Prepare the work on the messages of each connection.

    Parameters
    ----------
    routes
        The plan.
    conversions
        The conversion of each output.
    last
        Returns the consumer's last step with the results of a conversion, for messages of a connection.
    recording
        The topics of the recording that results are written to; None: no message passes as it is.
    """
    opened: dict[int, OpenRoute] = {}
    entries: dict[tuple[object, ...], TopicReport] = {}
    combinations: dict[Combination, Combiner] = {}
    combiners: dict[Output, Combiner] = {}

    def shared(entry: TopicReport) -> TopicReport:
        """Return the report's entry; publishers of one topic share it if their messages are handled alike."""
        key = (entry.topic, entry.msgtype, entry.target, entry.action, entry.note, entry.spec)
        return entries.setdefault(key, entry)

    for route in routes:
        connection = route.connection
        topic, msgtype = connection.topic, connection.ros_type
        if recording is None and not route.tasks:
            continue
        made = opened[connection.id] = OpenRoute(connection)
        passing = None
        if route.passes and recording is not None:
            passing = TopicReport(topic, msgtype, topic, "passed")
            made.passing_handle, made.encode = recording.add_passing(connection, passing)
        if not route.tasks:
            made.report = shared(passing or TopicReport(topic, msgtype, None, "skipped"))
            continue
        chosen = [conversions[task.key] for task in route.tasks]
        steps = [last(conversion, connection) for conversion in chosen]
        joined = [_combiner_of(combinations, *each) for each in zip(route.tasks, chosen, steps, strict=True)]
        # A group has the last step, not its messages.
        own_steps = [None if combiner else step for step, combiner in zip(steps, joined, strict=True)]
        made.convert = converter(chosen, topic, connection.serialization, msgtype, own_steps)
        made.shrinks_from = sum(conversion.shrinks_from for conversion in chosen)
        for place, (task, conversion, combiner) in enumerate(zip(route.tasks, chosen, joined, strict=True)):
            leads = task.combination is None or task.combination.sources[0] == topic
            for name in task.targets:
                action = "converted" if leads else "joined"
                entry = TopicReport(topic, msgtype, name, action, clouds_kept=made.passing_handle >= 0, spec=task.spec)
                if passing is not None and passing.lost:
                    entry.note, entry.lost = passing.note, True
                output = Output(shared(entry), place)
                if leads and recording is not None:
                    output.handle = recording.add_like(connection, name, conversion.made_type)
                made.outputs.append(output)
                if combiner is not None and task.combination is not None:
                    combiners[output] = combiner
                    combiner.reports[task.combination.sources.index(topic)] = output.report
            if (name := task.spec.keep_used) and leads and recording is not None:
                note = f"the points that the beams of {', '.join(task.targets)} read"
                entry = TopicReport(topic, msgtype, name, "added", note)
                points = Output(shared(entry), place, used=True)
                points.handle = recording.add_like(connection, name, POINTCLOUD2)
                made.outputs[-1].points = points
                made.outputs.append(points)
    return Routes(opened, list(entries.values()), combiners)


def _combiner_of(
    combiners: dict[Combination, Combiner], task: RouteTask, conversion: Conversion, last: Step
) -> Combiner | None:
    """Return the `Combiner` that makes one scan of several messages; all routes of a combination share it."""
    if task.combination is None:
        return None
    from .combine.combiner import Combiner  # noqa: PLC0415
    from .combine.conversion import MessagesToScan  # noqa: PLC0415  # few scans are made of several messages

    if not isinstance(conversion, MessagesToScan) or conversion.grouper is None:
        return None
    if task.combination not in combiners:
        combiners[task.combination] = Combiner(conversion, last)
    return combiners[task.combination]


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
    lasting = [route.connection for route in skipped if route.lasts]
    earlier = reader.counts(lasting, None, start_ns) if lasting and start_ns is not None else {}
    for route in skipped:
        (entry,) = route.reports
        before = earlier.get(route.connection.id, 0)
        entry.skip(
            counted.get(route.connection.id, 0) + (before if is_static(route.connection.topic) else min(before, 1))
        )
    return {key: route for key, route in routes.items() if key not in counted}
