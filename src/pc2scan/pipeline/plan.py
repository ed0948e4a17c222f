"""What goes where: a route for every connection of the source. Decides, and touches no file."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.topics import find_topics, matches, renamed, short_types
from pc2scan.errors import TopicError, name_list
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.names import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence
    from collections.abc import Set as AbstractSet

    from pc2scan.model import Connection

    from .options import ConvertOptions
    from .scan_spec import ScanSpec

__all__ = ["Plan", "Route", "Task", "make_plan"]


class Task(NamedTuple):
    """Something to be made of a message, and the topics that it goes to."""

    spec: ScanSpec
    targets: tuple[str, ...]


class Route(NamedTuple):
    """Where the messages of one source connection go.

    Attributes
    ----------
    tasks
        What its messages are converted to; none if they are not.
    passes
        Whether its own messages go to the destination.
    """

    connection: Connection
    tasks: tuple[Task, ...]
    passes: bool

    @property
    def targets(self) -> tuple[str, ...]:
        """The topics that its converted messages go to; none if it is not converted."""
        return tuple(target for task in self.tasks for target in task.targets)


class Plan(NamedTuple):
    """The routes in the order of the source's connections, the outputs, and what is worth a warning."""

    routes: tuple[Route, ...]
    specs: tuple[ScanSpec, ...] = ()
    warnings: tuple[str, ...] = ()


def make_plan(connections: Sequence[Connection], options: ConvertOptions) -> Plan:
    """Decide what is converted, what passes through and what is left out.

    Parameters
    ----------
    connections
        All of the source.
    options
        What was asked for.

    Raises
    ------
    TopicError
        If there is nothing to convert, a topic asked for is missing or of another type, or an output topic
        is already in the source.
    """
    specs = () if options.repair else options.specs
    targets = {spec: _placed_targets(connections, spec, options.drop) for spec in specs}
    routes = []
    for connection in connections:
        topic, kind = connection.topic, _kind(connection)
        tasks = tuple(
            Task(spec, found[topic]) for spec, found in targets.items() if topic in found and kind in spec.source_types
        )
        passes = not options.only_scans and (
            options.keep_clouds if tasks else _chosen(topic, options.keep, options.drop)
        )
        routes.append(Route(connection, tasks, passes))
    _refuse_collisions(routes)
    converted = {topic for found in targets.values() for topic in found}
    return Plan(tuple(routes), specs, tuple(_idle_patterns(connections, options, converted)))


def _placed_targets(
    connections: Sequence[Connection], spec: ScanSpec, drop: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """The same as `_targets`; an error says which output it is about."""
    try:
        return _targets(connections, spec, drop)
    except TopicError as err:
        if spec.place:
            err.message = f"{spec.place}, {spec.name}: {err.message}"
        raise


def _targets(connections: Sequence[Connection], spec: ScanSpec, drop: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """The topics to convert and the topics that their scans go to."""
    types = _types_by_topic(connections)
    convertible = spec.source_types
    candidates = [topic for topic, kinds in types.items() if not kinds.isdisjoint(convertible)]
    if spec.topics:
        requests: dict[str, list[str | None]] = {}
        for request in spec.topics:
            for topic in find_topics(request.source, types, candidates, *convertible):
                target = request.target and renamed(topic, request.source, request.target)
                requests.setdefault(topic, []).append(target)
    else:
        requests = {topic: [None] for topic in candidates if not matches(topic, drop)}
        if not requests:
            raise TopicError(_nothing_to_convert(types, candidates, convertible), hint=_other_direction(types, spec))
    single = len(requests) == 1
    if spec.name and not spec.topics:
        if not single:
            raise TopicError(
                f"it has no 'sources', and the recording has several {short_types(convertible)} topics: "
                f"{name_list(candidates)}",
                hint=f"write sources: {candidates[0]}",
            )
        return dict.fromkeys(requests, (spec.name,))
    name = spec.output.name

    def named(topic: str, target: str | None) -> str:
        return target or (f"/{name}" if single else f"{topic.rstrip('/')}/{name}")

    # Asked for twice is asked for once.
    return {
        topic: tuple(dict.fromkeys(named(topic, target) for target in targets)) for topic, targets in requests.items()
    }


def _nothing_to_convert(types: dict[str, set[str]], candidates: list[str], convertible: Sequence[str]) -> str:
    if candidates:
        return f"every {short_types(convertible)} topic is dropped: {name_list(candidates)}"
    if not types:
        return "the recording has no topics"
    described = [f"{topic} ({', '.join(sorted(kinds))})" for topic, kinds in sorted(types.items())]
    return f"the recording has no {short_types(convertible)} topic; its topics are: {name_list(described)}"


def _other_direction(types: dict[str, set[str]], spec: ScanSpec) -> str | None:
    """What may have been meant where there is nothing to convert."""
    there = {kind for kinds in types.values() for kind in kinds}
    if spec.reverse and (clouds := [kind for kind in CLOUDS if kind in there]):
        return f"it has {short_types(clouds)} topics; without `reverse` they become scans"
    if not spec.reverse and LASERSCAN in there:
        return "it has LaserScan topics; `reverse=True` turns those into clouds"
    return None


def _refuse_collisions(routes: Sequence[Route]) -> None:
    """No scan may share a topic with another scan or with what passes through."""
    passing = {route.connection.topic for route in routes if route.passes}
    origin: dict[str, tuple[str, ScanSpec]] = {}
    made = [(route.connection.topic, task) for route in routes for task in route.tasks]
    for topic, own, target in ((topic, task.spec, target) for topic, task in made for target in task.targets):
        source, spec = origin.setdefault(target, (topic, own))
        if source != topic:
            raise TopicError(
                f"{source} and {topic} would both become {target}; several sources are not merged into one scan",
                hint=f"give one of them another topic: `topics={topic}:={target}_2`",
            )
        if spec is not own:
            raise TopicError(f"{spec.name} ({spec.place}) and {own.name} ({own.place}) would both become {target}")
    for target, (source, spec) in origin.items():
        if target in passing:
            taken = passing | origin.keys()
            beside = f"{source.rstrip('/')}/{target.rsplit('/', 1)[-1]}"
            candidates = (beside, *(f"{target}_{n}" for n in range(2, len(taken) + 3)))
            free = next(name for name in candidates if name not in taken)
            how = "" if any(request.source == source for request in spec.topics) else " (the default)"
            raise TopicError(
                f"the recording already has a topic {target}, which {source} would be converted to{how}",
                hint=f"choose a free one: `topics={source}:={free}`, or leave the old one out: `drop={target}`",
            )


def _idle_patterns(
    connections: Sequence[Connection], options: ConvertOptions, converted: AbstractSet[str]
) -> list[str]:
    """A pattern that matches nothing is nearly always a typing error."""
    topics = {connection.topic for connection in connections}
    idle = []
    for name, patterns in (("keep", options.keep), ("drop", options.drop)):
        for pattern in patterns:
            matched = {topic for topic in topics if matches(topic, (pattern,))}
            if not matched:
                near = did_you_mean(pattern, sorted(topics))
                idle.append(f"`{name}={pattern}` matches no topic" + (f"; {near}" if near else ""))
            elif name == "keep" and matched <= converted and not options.keep_clouds:
                idle.append(
                    f"`keep={pattern}` matches only topics that are converted, and has no effect on them; "
                    "`keep_clouds=True` writes them too"
                )
    return idle


def _chosen(topic: str, keep: Sequence[str], drop: Sequence[str]) -> bool:
    return (not keep or matches(topic, keep)) and not matches(topic, drop)


def _types_by_topic(connections: Sequence[Connection]) -> dict[str, set[str]]:
    types: dict[str, set[str]] = {}
    for connection in connections:
        types.setdefault(connection.topic, set()).add(_kind(connection))
    return types


def _kind(connection: Connection) -> str:
    """The type, and how it is serialised if ROS did not do it (MCAP files also hold JSON and Protobuf)."""
    if connection.ros_version is None:
        return f"{connection.msgtype or 'untyped'} in {connection.serialization or 'no encoding'}"
    return connection.ros_type
