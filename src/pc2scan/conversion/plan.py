"""Plans a conversion: a route for every connection of the source. It only decides, and opens no file."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.topics import fill_glob, find_topic, find_topics, matches, short_types
from pc2scan.errors import NothingToConvertError, TopicError, name_list
from pc2scan.messages.clouds import CLOUDS, SCANS, usual_topics, written_as_pointcloud2
from pc2scan.messages.other_clouds import instead_of_topic, without
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from collections.abc import Set as AbstractSet

    from pc2scan.model import Connection
    from pc2scan.request.options import ConvertOptions, ScanSpec


class Combination:
    """Topics whose messages become one scan together. Two of them are never equal.

    Attributes
    ----------
    spec
        The output.
    sources
        The topics. The first one leads: the scans have its stamps.
    target
        The scans' topic.
    """

    __slots__ = ("sources", "spec", "target")

    def __init__(self, spec: ScanSpec, sources: tuple[str, ...], target: str) -> None:
        self.spec = spec
        self.sources = sources
        self.target = target


class RouteTask(NamedTuple):
    """One conversion of a message, and the topics that its result goes to.

    ``combination`` are the topics that the message becomes a scan with; None if it becomes a scan by itself.
    """

    spec: ScanSpec
    targets: tuple[str, ...]
    combination: Combination | None = None


class Route(NamedTuple):
    """Where the messages of one source connection go.

    Attributes
    ----------
    tasks
        The conversions of its messages; empty if they are not converted.
    passes
        Whether its messages are also written as they are.
    """

    connection: Connection
    tasks: tuple[RouteTask, ...]
    passes: bool

    @property
    def targets(self) -> tuple[str, ...]:
        """The topics that its converted messages go to; empty if it is not converted."""
        return tuple(target for task in self.tasks for target in task.targets)


class Plan(NamedTuple):
    """The routes in the order of the source's connections, the outputs, warnings and notes."""

    routes: tuple[Route, ...]
    specs: tuple[ScanSpec, ...] = ()
    combinations: tuple[Combination, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def needs_transforms(self) -> bool:
        """Whether any output is transformed."""
        return any(spec.needs_transforms for spec in self.specs)

    def sources_of(self, spec: ScanSpec, *combinations: Combination | None) -> list[Connection]:
        """Return the connections that an output converts; if given, only those of a combination (None: of none)."""
        return [
            route.connection
            for route in self.routes
            if any(task.spec is spec and (not combinations or task.combination in combinations) for task in route.tasks)
        ]


def make_plan(connections: Sequence[Connection], options: ConvertOptions) -> Plan:
    """Decide which topics are converted, which pass through, and which are skipped.

    Parameters
    ----------
    connections
        All connections of the source.
    options
        The options of the conversion.

    Raises
    ------
    TopicError
        If there is nothing to convert, a requested topic is missing or of another type, or an output topic
        already exists in the source.
    """
    specs = () if options.repair or options.no_scans else options.scans
    kinds = [connection.kind for connection in connections]
    types: dict[str, set[str]] = {}
    for connection, kind in zip(connections, kinds, strict=True):
        types.setdefault(connection.topic, set()).add(kind)
    targets: dict[ScanSpec, Mapping[str, Sequence[str]]] = {}
    combined: dict[ScanSpec, Sequence[Combination]] = {}
    for spec in specs:
        with spec.naming_errors(f"{spec.place}, " if spec.place else ""):
            if not spec.topics and not any(kind in spec.source_types for kind in kinds):
                raise _without_sources(connections, types, spec)
            targets[spec] = _targets(types, spec, options)
            combined[spec] = _combinations(spec, targets[spec], types, options)
    routes = []
    for connection, kind in zip(connections, kinds, strict=True):
        topic = connection.topic
        tasks = tuple(
            task for spec in specs for task in _tasks(spec, topic, kind, targets[spec].get(topic, ()), combined[spec])
        )
        wanted = (not options.keep or matches(topic, options.keep)) and not matches(topic, options.drop)
        passes = not options.only_scans and (options.keep_clouds if tasks else wanted)
        routes.append(Route(connection, tasks, passes))
    _refuse_collisions(routes)
    converted = {topic for found in targets.values() for topic in found}
    everything = tuple(each for found in combined.values() for each in found)
    idle = _pattern_warnings(types.keys(), options, converted) if options.keep or options.drop else ()
    if options.clouds_as == "pointcloud2" and not any(
        each.passes and written_as_pointcloud2(each.connection) for each in routes
    ):
        idle = (*idle, "`clouds_as=pointcloud2` has no effect: there are no clouds of other types to write")
    return Plan(tuple(routes), specs, everything, tuple(idle))


def _tasks(
    spec: ScanSpec, topic: str, kind: str, targets: Sequence[str], combinations: Sequence[Combination]
) -> list[RouteTask]:
    """Return the conversions of the messages of a type on a topic."""
    joined = [each for each in combinations if topic in each.sources]
    alone = tuple(target for target in targets if all(target != each.target for each in joined))
    tasks = [RouteTask(spec, alone)] if alone and kind in spec.source_types else []
    return tasks + [RouteTask(spec, (each.target,), each) for each in joined if kind in spec.named_types]


def _combinations(
    spec: ScanSpec, targets: Mapping[str, Sequence[str]], types: dict[str, set[str]], options: ConvertOptions
) -> list[Combination]:
    """Return the topics whose messages become scans together."""
    if not spec.may_combine:
        return []
    sources: dict[str, list[str]] = {}
    for topic, names in targets.items():
        for name in names:
            sources.setdefault(name, []).append(topic)
    asked = spec.combining
    found = []
    for target, topics in sources.items():
        if len(topics) == 1 and not (asked.accumulates or asked.rebin):
            # Only topics that share a target may have scans instead of clouds.
            find_topic(topics[0], types, [topic for topic in types if topic in targets], *spec.source_types)
            continue
        if len(topics) > 1 and not (spec.params.target_frame or options.frames.source_frame):
            raise TopicError(
                f"{name_list(topics)} become one scan on {target}, which needs a frame for the points of all: "
                "`target_frame`",
                hint="such as `target_frame=base_link`; `fixed_frame=odom` corrects the robot's motion between their "
                "stamps",
            )
        found.append(Combination(spec, tuple(topics), target))
    return found


def _targets(types: dict[str, set[str]], spec: ScanSpec, options: ConvertOptions) -> dict[str, tuple[str, ...]]:
    """Return the topics to convert, and the topics that their scans go to."""
    convertible = spec.named_types if spec.topics else spec.source_types
    candidates = [topic for topic, kinds in types.items() if not kinds.isdisjoint(convertible)]
    if spec.topics:
        requests: dict[str, list[str | None]] = {}
        for request in spec.topics:
            for topic in _matching_topics(request.source, types, candidates, spec):
                target = request.target and fill_glob(topic, request.source, request.target)
                requests.setdefault(topic, []).append(target)
    else:
        kept = [topic for topic in candidates if not matches(topic, options.drop)]
        if len(kept) > 1:
            kept = usual_topics({topic: types[topic] for topic in kept}, convertible)
        requests = {topic: [None] for topic in kept}
        if not requests:
            raise TopicError(
                f"every {short_types(convertible)} topic is dropped: {name_list(candidates)}",
                hint=_other_direction(types, spec),
            )
    single = len(requests) == 1
    if spec.name and not spec.topics:
        if not single:
            raise TopicError(
                f"it has no 'sources', and the recording has several {short_types(convertible)} topics: "
                f"{name_list(candidates)}",
                hint=f"write sources: {candidates[0]}",
            )
        return dict.fromkeys(requests, (spec.name,))
    name = "cloud" if spec.reverse else "scan"
    found = {}
    for topic, asked in requests.items():
        own = f"/{name}" if single else f"{topic.rstrip('/')}/{name}"
        if spec.combining.rebin:
            own = f"{topic}_rebinned" if options.keep_clouds else topic
        # A topic that is requested twice is converted once.
        found[topic] = tuple(dict.fromkeys(target or own for target in asked))
    return found


def _matching_topics(name: str, types: dict[str, set[str]], candidates: list[str], spec: ScanSpec) -> list[str]:
    """Return the topics that a name or a glob matches."""
    try:
        return find_topics(name, types, candidates, *spec.named_types)
    except TopicError as err:
        if not spec.reverse and not SCANS.keys().isdisjoint(types.get(name, ())):
            err.hint = f"`rebin=True` makes other scans of LaserScan, `reverse=True` makes clouds; {err.hint}"
        elif not candidates and name in types:
            err.hint = instead_of_topic(name, types[name]) or err.hint
        if all(kinds.isdisjoint(spec.source_types) for kinds in types.values()):
            raise NothingToConvertError(err.message, hint=err.hint) from err
        raise


def _without_sources(
    connections: Sequence[Connection], types: dict[str, set[str]], spec: ScanSpec
) -> NothingToConvertError:
    """Return the error about a recording with nothing to convert: what it has instead, and what makes clouds of it."""
    message, hint = without(short_types(spec.source_types), connections)
    return NothingToConvertError(message, hint=_other_direction(types, spec) or hint or None)


def _other_direction(types: dict[str, set[str]], spec: ScanSpec) -> str | None:
    """Return a hint if the recording can be converted in the other direction."""
    there = {kind for kinds in types.values() for kind in kinds}
    if spec.reverse and (clouds := [kind for kind in CLOUDS if kind in there]):
        return f"it has {short_types(clouds)} topics; without `reverse` they become scans"
    if spec.combining.rebin and (clouds := [kind for kind in CLOUDS if kind in there]):
        return f"it has {short_types(clouds)} topics; without `rebin` they become scans"
    if not spec.reverse and not SCANS.keys().isdisjoint(there):
        return (
            "its LaserScans can be used as they are, and pc2scan check judges them; `rebin=True` makes other scans of "
            "them, `reverse=True` clouds"
        )
    return None


def _refuse_collisions(routes: Sequence[Route]) -> None:
    """Raise if a scan would share a topic with another scan, or with messages that pass through."""
    passing = {route.connection.topic for route in routes if route.passes}
    origin: dict[str, tuple[str, RouteTask]] = {}
    made = [
        (route.connection.topic, task, target)
        for route in routes
        for task in route.tasks
        for target in (*task.targets, *filter(None, (task.spec.keep_used,)))
    ]
    scans = {target for route in routes for target in route.targets}
    if used := next((task.spec.keep_used for _, task, _ in made if task.spec.keep_used in scans), None):
        raise TopicError(f"{used} is the topic of a scan, `keep_used` needs a different topic")
    for topic, own, target in made:
        source, task = origin.setdefault(target, (topic, own))
        if task.spec is not own.spec:
            one, other = task.spec, own.spec
            raise TopicError(f"{one.name} ({one.place}) and {other.name} ({other.place}) would both become {target}")
        if source != topic and task.combination is None:
            raise TopicError(
                f"{source} and {topic} would both become {target}; several scans are not merged into one cloud",
                hint=f"give one of them another topic: `topics={topic}:={target}_2`",
            )
    for target, (source, task) in origin.items():
        spec = task.spec
        if target in passing:
            taken = passing | origin.keys()
            beside = f"{source.rstrip('/')}/{target.rsplit('/', 1)[-1]}"
            candidates = (beside, *(f"{target}_{n}" for n in range(2, len(taken) + 3)))
            free = next(name for name in candidates if name not in taken)
            how = "" if any(request.source == source for request in spec.topics) else " (the default)"
            raise TopicError(
                f"the recording already has a topic {target}, which {source} would be converted to{how}",
                hint=f"choose a free one: `topics={source}:={free}`, or drop the existing one: `drop={target}`",
            )


def _pattern_warnings(topics: AbstractSet[str], options: ConvertOptions, converted: AbstractSet[str]) -> list[str]:
    """Return warnings about patterns that match no topic: they are nearly always typing errors."""
    idle = []
    for name, patterns in (("keep", options.keep), ("drop", options.drop)):
        for pattern in patterns:
            matched = {topic for topic in topics if matches(topic, (pattern,))}
            if not matched and pattern.startswith("'"):
                bare = pattern.strip("'")
                raise TopicError(
                    f"`{name}` {pattern}: no topic has quotes in its name",
                    hint=f'in Windows\' command prompt, only double quotes are quotes: `{name}` "{bare}"',
                )
            if not matched:
                near = did_you_mean(pattern, sorted(topics))
                idle.append(f"`{name}={pattern}` matches no topic" + (f"; {near}" if near else ""))
            elif name == "keep" and matched <= converted and not options.keep_clouds:
                idle.append(
                    f"`keep={pattern}` matches only topics that are converted, and has no effect on them; "
                    "`keep_clouds=True` writes them too"
                )
    return idle
