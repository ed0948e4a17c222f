"""Plans a conversion: a route for every connection of the source. It only decides, and opens no file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.topics import by_topic, fill_glob, find_topic, find_topics, matches, short_types
from pc2scan.errors import NothingToConvertError, TopicError, leading, name_list
from pc2scan.messages.clouds import CLOUDS, SCANS, usual_topics
from pc2scan.messages.other_clouds import instead_of_topic, without
from pc2scan.text import did_you_mean

from .steps import as_it_is

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from pc2scan.model import Buffer, Connection
    from pc2scan.request.spec import Request, ScanSpec

    from .report import TopicReport
    from .steps import ConvertedMessage, Steps


@dataclass(slots=True, eq=False)
class Output:
    """A topic of the destination, which the results of a connection's messages go to.

    Attributes
    ----------
    spec
        The request, a `ScanSpec`; None if its messages are only decoded, or are transforms.
    target
        The topic.
    joined, sources
        The topic of scans that are made of several messages, and the topics of these messages; scans have the stamps of
        the first one, which leads. Empty: each message becomes a scan by itself.
    used
        Whether it has the points that give scans their ranges.
    index
        The number of its conversion among those of the route.
    report
        The report's entry, which publishers of a topic share.
    handle
        The writer's; -1 if nothing is written, or if another topic leads the scans.
    combiner
        The `Combiner` that makes its scans of several messages; None: each message becomes one.
    first
        Its first message; all others have the same geometry.
    """

    spec: Any
    target: str
    joined: str = ""
    sources: tuple[str, ...] = ()
    used: bool = False
    index: int = 0
    report: Any = None
    handle: int = -1
    combiner: Any = None
    first: Any = None


@dataclass(slots=True, eq=False)
class Route:
    """What is done with the messages of one connection.

    Attributes
    ----------
    outputs
        Who takes what becomes of them; none if they are not converted.
    passes
        Whether they are also written as they are.
    decode, steps
        Decodes a message; and what is done with it then, once for all outputs of one conversion. Like what follows,
        `recording.equip_routes` sets them, when the transforms are known.
    encode
        The consumer's last step with each result.
    handle
        The writer's for messages as they are; -1 if they are not written.
    reencode
        Makes what is written of messages as they are; None if that is what was read.
    report
        The report's entry of messages that are not converted; each output has another one.
    messages
        How many were read.
    """

    connection: Connection
    outputs: list[Output] = field(default_factory=list)
    passes: bool = False
    decode: Callable[[Buffer], Any] = bytes
    steps: Sequence[Steps] = ()
    encode: Callable[[ConvertedMessage], ConvertedMessage] = as_it_is
    handle: int = -1
    reencode: Callable[[Buffer], Buffer] | None = None
    report: Any = None
    messages: int = 0

    @property
    def targets(self) -> tuple[str, ...]:
        """The topics of its scans or clouds; empty if it is not converted."""
        return tuple(output.target for output in self.outputs if not output.used)

    @property
    def reports(self) -> Sequence[TopicReport]:
        """The report's entries that count its messages."""
        own = [output.report for output in self.outputs]
        return own if self.report is None else [self.report, *own]

    @property
    def writes(self) -> bool:
        """Whether something becomes of its messages; otherwise they are only counted."""
        return self.handle >= 0 or bool(self.outputs)

    @property
    def words(self) -> Iterator[str]:
        """What is done with its messages, a line for each output."""
        topic, kind = self.connection.topic, short_types([self.connection.ros_type])
        for output in self.outputs:
            if output.spec is not None and not output.used:
                yield f"{leading(topic)}: decode {kind}, {', '.join(_steps_in_words(output, topic))}: {output.target}"


class Plan(NamedTuple):
    """The routes in the order of the source's connections, those that are converted, the outputs, and warnings."""

    routes: Sequence[Route]
    converted: Sequence[Connection]
    specs: tuple[ScanSpec, ...]
    warnings: Sequence[str]

    def sources_of(self, spec: ScanSpec, joined: str | None = None) -> list[Connection]:
        """Return the connections that an output converts.

        With the topic of scans that are made of several messages, only their connections; if it is empty, those whose
        messages become scans by themselves.
        """
        return [
            route.connection
            for route in self.routes
            if any(taker.spec is spec and joined in (None, taker.joined) for taker in route.outputs)
        ]


def _steps_in_words(output: Output, topic: str) -> Iterator[str]:
    """Yield what is done with a decoded message."""
    spec = output.spec
    frame = spec.params.target_frame or "its own frame"
    moved = f", each point at its own time by {spec.fixed_frame or frame}" if spec.deskew else ""
    yield f"place in {frame}{' made level' if spec.level else ''}{moved}"
    if spec.filters:
        yield f"select by {', '.join(point_filter.name for point_filter in spec.filters)}"
    yield "make points of the beams" if spec.reverse else "project"
    if spec.remove:
        yield f"remove {', '.join(spec.remove)}"
    if spec.combining.accumulates:
        yield "combine with the messages before"
    if others := [source for source in output.sources if source != topic]:
        yield f"combine with {', '.join(others)}"


def make_plan(connections: Sequence[Connection], request: Request) -> Plan:
    """Decide which topics are converted, which pass through, and which are skipped.

    Parameters
    ----------
    connections
        All connections of the source.
    request
        The options of the conversion.

    Raises
    ------
    TopicError
        If there is nothing to convert, a requested topic is missing or of another type, or an output topic
        already exists in the source.
    """
    specs = () if request.repair or request.no_scans else request.scans
    types = {topic: {connection.kind for connection in own} for topic, own in by_topic(connections).items()}
    targets: dict[ScanSpec, Mapping[str, Sequence[str]]] = {}
    together: dict[ScanSpec, Mapping[str, Sequence[str]]] = {}
    for spec in specs:
        with spec.naming_errors(f"{spec.place}, " if spec.place else ""):
            if not spec.topics and all(kinds.isdisjoint(spec.types()) for kinds in types.values()):
                message, hint = without(short_types(spec.types()), connections)
                raise NothingToConvertError(message, hint=_other_direction(types, spec) or hint or None)
            targets[spec] = _targets(types, spec, request)
            together[spec] = _combined(spec, targets[spec], types, request) if spec.may_combine else {}
    routes = []
    for connection in connections:
        topic = connection.topic
        outputs: list[Output] = []
        for spec in specs:
            begin = outputs[-1].index + 1 if outputs else 0
            outputs += _outputs(spec, connection.kind, targets[spec].get(topic, ()), together[spec], begin)
        dropped = request.drop and matches(topic, request.drop)
        is_kept = not dropped and (not request.keep or matches(topic, request.keep))
        passes = not request.only_scans and (request.keep_clouds if outputs else is_kept)
        routes.append(Route(connection, outputs, passes))
    _refuse_collisions(routes)
    idle: list[str] = []
    if request.keep or request.drop:
        replaced = {topic for topics in targets.values() for topic in topics if not request.keep_clouds}
        idle = [*_idle_patterns("keep", request.keep, types, replaced), *_idle_patterns("drop", request.drop, types)]
    return Plan(routes, [route.connection for route in routes if route.outputs], specs, idle)


def _outputs(
    spec: ScanSpec, kind: str, targets: Sequence[str], together: Mapping[str, Sequence[str]], begin: int
) -> Iterator[Output]:
    """Yield the outputs of the messages of a type on a topic; conversions are numbered from ``begin`` on."""
    alone = [target for target in targets if target not in together] if kind in spec.types() else []
    joined = [target for target in targets if target in together] if kind in spec.types(named=True) else []
    for number, (scan, names) in enumerate([("", alone)] * bool(alone) + [(name, [name]) for name in joined], begin):
        sources = tuple(together.get(scan, ()))
        yield from (Output(spec, name, scan, sources, index=number) for name in names)
        if spec.keep_used:
            yield Output(spec, spec.keep_used, used=True, index=number)


def _combined(
    spec: ScanSpec, targets: Mapping[str, Sequence[str]], types: dict[str, set[str]], request: Request
) -> dict[str, list[str]]:
    """Return the topics of scans that are made of several messages, each with the topics of these."""
    sources: dict[str, list[str]] = {}
    for topic, names in targets.items():
        for name in names:
            sources.setdefault(name, []).append(topic)
    combining = spec.combining
    for target, topics in list(sources.items()):
        if len(topics) == 1 and not (combining.accumulates or combining.rebin):
            # Only topics that share a target may have scans instead of clouds.
            find_topic(topics[0], types, [topic for topic in types if topic in targets], *spec.types())
            del sources[target]
        elif len(topics) > 1 and not (spec.params.target_frame or request.frames.source_frame):
            raise TopicError(
                f"{name_list(topics)} become one scan on {target}, which needs a frame for the points of all: "
                "`target_frame`",
                hint="such as `target_frame=base_link`; `fixed_frame=odom` corrects the robot's motion between their "
                "stamps",
            )
    return sources


def _targets(types: dict[str, set[str]], spec: ScanSpec, request: Request) -> dict[str, tuple[str, ...]]:
    """Return the topics to convert, and the topics that their scans go to."""
    convertible = spec.types(named=bool(spec.topics))
    candidates = [topic for topic, kinds in types.items() if not kinds.isdisjoint(convertible)]
    if spec.topics:
        requests: dict[str, list[str | None]] = {}
        for chosen in spec.topics:
            for topic in _matching_topics(chosen.source, types, candidates, spec):
                target = chosen.target and fill_glob(topic, chosen.source, chosen.target)
                requests.setdefault(topic, []).append(target)
    else:
        kept = [topic for topic in candidates if not (request.drop and matches(topic, request.drop))]
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
    targets = {}
    for topic, names in requests.items():
        own = f"/{name}" if single else f"{topic.rstrip('/')}/{name}"
        if spec.combining.rebin:
            own = f"{topic}_rebinned" if request.keep_clouds else topic
        # A topic that is requested twice is converted once.
        targets[topic] = tuple(dict.fromkeys(target or own for target in names))
    return targets


def _matching_topics(name: str, types: dict[str, set[str]], candidates: list[str], spec: ScanSpec) -> list[str]:
    """Return the topics that a name or a glob matches."""
    try:
        return find_topics(name, types, candidates, *spec.types(named=True))
    except TopicError as err:
        if not spec.reverse and not SCANS.keys().isdisjoint(types.get(name, ())):
            err.hint = f"`rebin=True` makes other scans of LaserScan, `reverse=True` makes clouds; {err.hint}"
        elif not candidates and name in types:
            err.hint = instead_of_topic(name, types[name]) or err.hint
        if all(kinds.isdisjoint(spec.types()) for kinds in types.values()):
            raise NothingToConvertError(err.message, hint=err.hint) from err
        raise


def _other_direction(types: dict[str, set[str]], spec: ScanSpec) -> str | None:
    """Return a hint if the recording can be converted in the other direction."""
    recorded_types = {kind for kinds in types.values() for kind in kinds}
    clouds = [kind for kind in CLOUDS if kind in recorded_types]
    if clouds and (option := "reverse" if spec.reverse else "rebin" if spec.combining.rebin else ""):
        return f"it has {short_types(clouds)} topics; without `{option}` they become scans"
    if not spec.reverse and not SCANS.keys().isdisjoint(recorded_types):
        return (
            "its LaserScans can be used as they are, and pc2scan check judges them; `rebin=True` makes other scans of "
            "them, `reverse=True` clouds"
        )
    return None


def _refuse_collisions(routes: Sequence[Route]) -> None:
    """Raise if a scan would share a topic with another scan, or with messages that pass through."""
    passing = {route.connection.topic for route in routes if route.passes}
    scans = {output.target for route in routes for output in route.outputs if not output.used}
    origin: dict[str, tuple[str, Output]] = {}
    for topic, own in ((route.connection.topic, output) for route in routes for output in route.outputs):
        target = own.target
        if own.used and target in scans:
            raise TopicError(f"{target} is the topic of a scan, `keep_used` needs a different topic")
        source, first = origin.setdefault(target, (topic, own))
        if first.spec is not own.spec:
            one, other = first.spec, own.spec
            raise TopicError(f"{one.name} ({one.place}) and {other.name} ({other.place}) would both become {target}")
        if source != topic and not first.joined:
            raise TopicError(
                f"{source} and {topic} would both become {target}; several scans are not merged into one cloud",
                hint=f"give one of them another topic: `topics={topic}:={target}_2`",
            )
    for target, (source, output) in origin.items():
        if target in passing:
            names = passing | origin.keys()
            beside = f"{source.rstrip('/')}/{target.rsplit('/', 1)[-1]}"
            candidates = (beside, *(f"{target}_{n}" for n in range(2, len(names) + 3)))
            free = next(name for name in candidates if name not in names)
            named = any(request.source == source for request in output.spec.topics)
            how = "" if named else " (the default)"
            raise TopicError(
                f"the recording already has a topic {target}, which {source} would be converted to{how}",
                hint=f"choose a free one: `topics={source}:={free}`, or drop the existing one: `drop={target}`",
            )


def _idle_patterns(
    name: str, patterns: Sequence[str], topics: Collection[str], replaced: Collection[str] = ()
) -> Iterator[str]:
    """Yield warnings about patterns that match no topic, or only topics whose messages become scans."""
    for pattern in patterns:
        if matched := [topic for topic in topics if matches(topic, (pattern,))]:
            if all(topic in replaced for topic in matched):
                yield (
                    f"`{name}={pattern}` matches only topics that are converted, and has no effect on them; "
                    "`keep_clouds=True` writes them too"
                )
            continue
        if pattern.startswith("'"):
            bare = pattern.strip("'")
            raise TopicError(
                f"`{name}` {pattern}: no topic has quotes in its name",
                hint=f'in Windows\' command prompt, only double quotes are quotes: `{name}` "{bare}"',
            )
        near = did_you_mean(pattern, sorted(topics))
        yield f"`{name}={pattern}` matches no topic" + (f"; {near}" if near else "")
