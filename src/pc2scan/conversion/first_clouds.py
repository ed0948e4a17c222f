"""Converts the first clouds of each topic before anything is written: they are judged, and dry runs count them."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

from pc2scan.advice.first_clouds import FirstCloud, are_enough, judge
from pc2scan.bags.topics import by_topic
from pc2scan.core.points import Points
from pc2scan.core.scene import JUDGED_CLOUDS, PARTS, WHOLE_POINTS, CloudSample
from pc2scan.errors import MessageError, UnconnectedError

from .combine.conversion import Contribution
from .engine import convert
from .result_checks import result_findings
from .stages import ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from pc2scan.model import RawMessage
    from pc2scan.request.options import ScanSpec

    from .engine import Item, Tally
    from .plan import Output, Route
    from .preparation import Preparation
    from .report import Report

#: How many messages of a topic are read at most, to find clouds that can be converted; and how many of them must lack
#: transforms before a user is warned.
_MOST_READ = 30
_UNCONNECTED = 10


def judge_first(routes: Mapping[int, Route], prepared: Preparation, report: Report, tally: Tally | None = None) -> None:
    """Add to the report what the first clouds of each topic show.

    Parameters
    ----------
    tally
        Counts these clouds, in a dry run: all are read until one is connected with the target frame.
    """
    reader, tell = prepared.reader, prepared.tell
    converted = [route.connection for route in routes.values() if any(each.spec for each in route.outputs)]
    for topic, connections in by_topic(converted).items():
        specs = {each.spec for own in connections for each in routes[own.id].outputs}
        clouds: dict[ScanSpec, list[FirstCloud]] = {spec: [] for spec in specs if spec and not spec.reverse}
        if tally is None and not clouds:
            continue
        read = successes = 0
        unconnected: list[UnconnectedError] = []
        with closing(reader.messages(connections, prepared.span.start_ns, prepared.span.stop_ns)) as messages:
            for message in messages:
                item = convert(routes, message)
                item = item._replace(results=[(output, _alone(output, result)) for output, result in item.results])
                read, successes = read + 1, successes + (item.failure is None)
                unconnected += [item.failure] if isinstance(item.failure, UnconnectedError) else []
                if tally is not None:
                    tally.count(item)
                if read == len(unconnected) == _UNCONNECTED:
                    why = f"{unconnected[0].message}{'; ' * bool(unconnected[0].hint)}{unconnected[0].hint or ''}"
                    tell(f"none of the first {read} messages can be converted: {topic}: {why}")
                wanted = [spec for spec, own in clouds.items() if not are_enough(topic, spec, own, prepared.known)]
                for spec, cloud in _samples(item, message, wanted, prepared):
                    clouds[spec].append(cloud)
                if tally is None and all(are_enough(topic, *each, prepared.known) for each in clouds.items()):
                    break
                are_parts = tally is None and any(
                    own and len(own[0].sample.points) < WHOLE_POINTS for own in clouds.values()
                )
                most = PARTS if are_parts else JUDGED_CLOUDS
                if successes == most or (read >= max(most, _MOST_READ) and (tally is None or tally.is_connected)):
                    break
        for spec, own in clouds.items():
            if own:
                judged = judge(topic, spec, own, prepared.known)
                tell(*judged.warnings)
                report.add((), judged.notes)
                for entry in report.topics:
                    if entry.topic == topic and entry.spec is spec:
                        entry.advice, entry.no_returns = judged.advice, judged.no_returns


def _alone(output: Output, result: Any) -> Any:
    """Return the scan of a message alone, if it leads a scan of several."""
    if not isinstance(result, Contribution) or output.combiner is None or result.source:
        return result
    try:
        return output.combiner.alone(result)
    except MessageError as err:
        return err


def _samples(
    item: Item, message: RawMessage, specs: Collection[ScanSpec], prepared: Preparation
) -> Iterator[tuple[ScanSpec, FirstCloud]]:
    """Yield a sample of a cloud for each of these outputs that it became a scan of."""
    scans = {
        output.spec: (output, result)
        for output, result in item.results
        if output.spec in specs and isinstance(result, ConvertedMessage)
    }
    points = item.route.decode(message.data) if scans else None
    if isinstance(points, Points):
        sample = CloudSample.of(points)
        for spec, (output, scan) in scans.items():
            place = prepared.conversions[output.key].placer.place(points.frame_id, scan.stamp_ns or points.stamp_ns)
            yield spec, FirstCloud(sample.placed_in(place.frame_id, place.target_from_source), scan.counts)


def count_by_index(routes: Mapping[int, Route], prepared: Preparation, report: Report) -> None:
    """Fill in the report of a dry run: its points are those of the first messages, its counts those of the index."""
    reader, span = prepared.reader, prepared.span
    report.ways = [words for route in prepared.plan.routes for words in route.words]
    report.add(reader.remarks)
    report.damage += reader.damage
    report.add(*result_findings(report))
    for entry in (entry for route in routes.values() for entry in route.reports):
        entry.messages_in = entry.messages_out = entry.skipped = 0
    counts = reader.counts([route.connection for route in routes.values()], span.start_ns, span.stop_ns)
    uncounted = set()
    for key, route in routes.items():
        count = counts.get(key, route.connection.message_count)
        if count is None:
            uncounted.add(route.connection.topic)
        for entry in route.reports:
            entry.messages_in += count or 0
            # How many intervals have a leading message is not known.
            if route.writes and not (entry.spec is not None and entry.spec.combining.every_ns):
                entry.messages_out += count or 0
    if uncounted:
        report.notes.append(f"no index counts the messages on {', '.join(sorted(uncounted))}")
