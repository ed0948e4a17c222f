"""Reads the messages of a recording one after the other, or makes scans of its clouds, for loops in Python."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from contextlib import ExitStack, closing, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar
from weakref import WeakSet, finalize

import numpy as np

from pc2scan.advice.checks import request_warnings
from pc2scan.bags.damage import mention
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import by_topic, find_topics, short_types, types_by_topic
from pc2scan.conversion.corrections import corrected, scaled
from pc2scan.conversion.engine import Tally, items_of
from pc2scan.conversion.plan import Output, Route, make_plan
from pc2scan.conversion.preparation import judge_first, prepare, refuse_no_messages, span_of
from pc2scan.conversion.recording import equip_routes
from pc2scan.conversion.report import Report, TopicReport
from pc2scan.conversion.result_checks import result_findings
from pc2scan.conversion.steps import ConvertedMessage, Steps
from pc2scan.core.rule import NO_POINTS
from pc2scan.errors import NothingToConvertError, Pc2ScanError, RecordingWarning, TopicError, name_list, visible
from pc2scan.messages.clouds import CLOUDS, usual_topics
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan, encode_laserscan
from pc2scan.messages.other_clouds import without
from pc2scan.messages.pointcloud2 import recorded_cloud
from pc2scan.model import StoredChunk, own_data
from pc2scan.result import tell_early
from pc2scan.threads import Threads, cores

from .objects import Cloud, Scan

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Mapping, Sequence
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

    from pc2scan.advice.survey import Span
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.conversion.engine import Item as EngineItem
    from pc2scan.messages.pointcloud2 import PointCloud2
    from pc2scan.model import Buffer, Connection
    from pc2scan.progress import Meter
    from pc2scan.request.spec import Request
    from pc2scan.result import Skipped
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import LevelTransform

_RECORDED = ((LASERSCAN,), "it has LaserScan topics, which are read as they are without any parameters")

#: What a scan has of its message, in the order of `Scan`.
_DECODED = (
    *("stamp_ns", "frame_id", "sequence", "angle_min", "angle_max", "angle_increment", "time_increment", "scan_time"),
    *("range_min", "range_max", "ranges", "intensities"),
)

#: How many topics ``repr`` names.
_SHOWN = 3

Item = TypeVar("Item")


class StreamSource(NamedTuple):
    """An open recording, ready to be read.

    Attributes
    ----------
    stack
        Closes the readers.
    readers
        The recording, and others that were opened for it.
    topics
        The topics of the items.
    routes
        The route of each connection's messages.
    span
        The cut.
    jobs
        The number of threads; 0: one for each processor core.
    warnings
        The warnings of a conversion, which adds more while it is read.
    conclude
        Adds the last warnings, at the end.
    """

    stack: ExitStack
    readers: Sequence[Reader]
    topics: tuple[str, ...]
    routes: Mapping[int, Route]
    span: Span
    jobs: int = 1
    warnings: Sequence[str] = ()
    conclude: Callable[[], None] = lambda: None

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts of the recordings that were read."""
        return tuple(damage for reader in self.readers for damage in reader.damage)


class Stream(ABC, Generic[Item]):
    """The messages of a recording, read as they are iterated over.

    The recording is opened immediately, so that a wrong request raises here and not in the loop.
    Each loop reads it from the beginning. Its files are closed when the loop ends, is left and forgotten, or with
    `close` or a ``with`` statement.

    Parameters
    ----------
    paths
        Recordings; several are read as one.
    options
        Topics, cut, and the others that apply.
    all_topics
        Whether all topics of the type are read if none are named; otherwise there must be only one.
    meter
        Counts the bytes of preparing, and of the first loop; None: nothing is reported.

    Attributes
    ----------
    topics
        The topics that are read.
    strict
        Whether damage, and a message that cannot be used, are errors.
    damage
        The damage that the last loop found.
    skipped
        The first hundred messages that the last loop could not use.
    skipped_count
        How many these were.
    notes
        Values that were measured, or chosen by default.
    """

    def __init__(
        self, paths: Sequence[Path], request: Request, *, all_topics: bool = False, meter: Meter | None = None
    ) -> None:
        self._paths = tuple(paths)
        self._options = request
        self.strict = request.strict
        self._all_topics = all_topics
        self._meter = meter
        self._live: WeakSet[Generator[EngineItem]] = WeakSet()
        self.notes: tuple[str, ...] = ()
        self.skipped: list[Skipped] = []
        self.skipped_count = 0
        #: Receives the warnings of a conversion as soon as they are known, instead of Python's warnings; its owner
        #: reports the rest.
        self.listener: Callable[[str], None] | None = None
        source = self._open()
        self._prepared: StreamSource | None = source
        #: Closes the open files if the object is never iterated over.
        self._release = finalize(self, source.stack.close)
        self._release.atexit = False
        self.topics = source.topics
        self.damage: tuple[Damage, ...] = source.damage

    #: The types that are read as they are; and those that are read otherwise, and how.
    _kinds: ClassVar[Collection[str]]
    _hint: ClassVar[tuple[Collection[str], str]]

    @abstractmethod
    def _decoder(self, connection: Connection) -> Callable[[Buffer], Any]:
        """Return the decoder of a connection's messages, which does not keep more than its message in memory."""

    @abstractmethod
    def _object(self, topic: str, log_time_ns: int, message: Any) -> Item:
        """Return the object of a message, as a route of the source has made it."""

    def _choose(
        self, reader: Reader, kinds: Collection[str], hint: tuple[Collection[str], str]
    ) -> dict[str, list[Connection]]:
        """Return the connections of the topics to read, by topic.

        Parameters
        ----------
        kinds
            The types of the topics, in ROS 2's spelling.
        hint
            Types that are read otherwise, and how, for a recording without such topics.

        Raises
        ------
        TopicError
            If a topic is missing or has another type, or if none was requested and there are several.
        """
        types = types_by_topic(reader.connections)
        chosen = by_topic(own for own in reader.connections if own.ros_type in kinds and own.ros_version is not None)
        instead = hint[1] if any(connection.ros_type in hint[0] for connection in reader.connections) else None
        if not chosen:
            message, other = without(short_types(kinds), reader.connections)
            raise NothingToConvertError(message, path=reader.path, hint=instead or other or None)
        if requested := self._options.scan.topics:
            try:
                names = [
                    name for request in requested for name in find_topics(request.source, types, sorted(chosen), *kinds)
                ]
            except TopicError as err:
                err.path, err.hint = reader.path, instead or err.hint
                raise
            return {name: chosen[name] for name in dict.fromkeys(names)}
        usual = sorted(usual_topics({topic: types[topic] for topic in chosen}, kinds))
        if len(usual) > 1 and not self._all_topics:
            raise TopicError(
                f"the recording has {len(usual)} {short_types(kinds)} topics: {name_list(usual)}",
                path=reader.path,
                hint=f'choose: topics="{usual[0]}", or a list of several',
            )
        return {topic: chosen[topic] for topic in usual}

    def _source(self, stack: ExitStack, reader: Reader) -> StreamSource:
        """Return what is read from an open recording: the messages as they are."""
        options = self._options
        chosen = self._choose(reader, self._kinds, self._hint)
        span = span_of(reader, options)
        if options.clock:
            wanted = [connection for connections in chosen.values() for connection in connections]
            reader, notes = corrected(reader, wanted, options.clock, (), span)
            self.notes = tuple(notes)
        routes = {}
        for topic, connections in chosen.items():
            output = Output(None, topic, report=TopicReport(topic, connections[0].ros_type, topic, "converted"))
            for connection in connections:
                decode = _step(self._decoder(connection))
                # A message is decoded at once: its object takes no more memory.
                routes[connection.id] = Route(connection, [output], decode=decode, steps=[Steps()])
        # One thread: objects are as large as their messages, and others would hold many of them ahead of the loop.
        return StreamSource(stack, [reader], tuple(chosen), routes, span)

    def _open(self) -> StreamSource:
        options = self._options
        with ExitStack() as stack:
            reader = scaled(as_one(open_recordings(self._paths, stack, strict=options.strict)), options.cloud_scale)
            try:
                source = self._source(stack, reader)
            except TopicError as err:
                mention(reader.damage, err)
                raise
            reader, (start_ns, stop_ns, _) = source.readers[0], source.span
            connections = [route.connection for route in source.routes.values()]
            if self._meter is not None:
                self._meter.following = reader.stored_bytes(connections, start_ns, stop_ns)
            # A topic without messages gives an empty loop, but a cut outside of the recording is an error.
            if start_ns is not None or stop_ns is not None:
                with suppress(TopicError):
                    refuse_no_messages(reader, connections, start_ns, stop_ns)
            # No error: the files stay open.
            return source._replace(stack=stack.pop_all())

    def __iter__(self) -> Generator[Item]:
        return self._items(self.results())

    def _items(self, results: Generator[EngineItem]) -> Generator[Item]:
        with closing(results):
            # What is kept in memory ends with the loop's own reference to it.
            for result in results:
                objects = self.objects(result)
                del result
                for item, _ in objects:
                    yield item
                    del item
                del objects

    def results(self) -> Generator[EngineItem]:
        """Return what each message becomes, for callers that report errors themselves.

        Raises
        ------
        MessageError
            In the loop, if it is certain that no message can be used.
        """
        source, self._prepared = self._prepared, None
        if source is None:
            source = self._open()
        else:
            self._release.detach()
        results = self._results(source)
        self._live.add(results)
        # From here on the generator closes the files in any case.
        next(results)
        return results

    def _results(self, source: StreamSource) -> Generator[EngineItem]:
        """Yield what each message becomes, after a first None."""
        with source.stack as stack:
            yield None  # type: ignore[misc]
            tally = Tally(source.routes, strict=self.strict)
            self.skipped, self.skipped_count = tally.skipped, 0
            self.damage = source.damage
            warned = self._warn_of_damage(0)
            count = 0
            meter, self._meter = self._meter, None
            jobs = source.jobs or cores()
            items = items_of(
                source.readers[0],
                source.routes,
                source.span,
                stack.enter_context(closing(Threads(jobs))) if jobs > 1 else None,
                window=self._options.window,
                meter=meter,
            )
            stack.enter_context(closing(items))
            try:
                count = self._warn(source.warnings)
                for item in items:
                    # No rule allows whole chunks here.
                    assert not isinstance(item, StoredChunk)
                    tally.count(item)
                    if self.listener is None and self.skipped_count == 0 < tally.failures:
                        error = item.errors[0]
                        hint = f" ({error.hint})" if error.hint else ""
                        self._warn([f"skipped: {error}{hint}; see .skipped for all; strict=True makes them errors"])
                    self.skipped_count = tally.failures
                    count = self._warn(source.warnings, count)
                    yield item
                    del item
                tally.finish()
            except Pc2ScanError:
                # Often the cause.
                self._warn(source.warnings, count)
                raise
            source.conclude()
            self._warn(source.warnings, count)
            self.damage = source.damage
            self._warn_of_damage(warned)

    def objects(self, item: EngineItem) -> list[tuple[Item, LevelTransform | None]]:
        """Return the objects of a message, each with the transform of a level scan's frame."""
        return [
            (self._object(output.report.target or "", item.log_time_ns, result.message), result.level)
            for output, result in item.results
            if isinstance(result, ConvertedMessage)
        ]

    def _warn(self, texts: Sequence[str], count: int = 0, depth: int = 4) -> int:
        """Pass on the texts after those that were told: to `listener`, or as warnings about the line of the loop."""
        for text in texts[count:]:
            if self.listener is not None:
                self.listener(text)
            else:
                warnings.warn(text, RecordingWarning, stacklevel=depth)
        return len(texts)

    def _warn_of_damage(self, warned: int) -> int:
        """Warn of damage that has not been reported yet; return how many places there are now."""
        if self.listener is None and len(self.damage) > warned:
            more = f" and {len(self.damage) - 1} more places" if len(self.damage) > 1 else ""
            text = (
                f"damaged: {self.damage[0]}{more}; see .damage. The rest is read; strict=True refuses such recordings"
            )
            self._warn([text], depth=5)
        return len(self.damage)

    def __reduce__(self) -> tuple[object, ...]:
        """Return how to open the recording anew, for copies, and for processes that read it, too."""
        return type(self), (self._paths, self._options)

    def close(self) -> None:
        """Close the files, and end the loops that are not finished. A new loop opens them again."""
        for results in tuple(self._live):
            results.close()
        self._prepared = None
        self._release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        paths = ", ".join(repr(str(path)) for path in self._paths)
        more = ", ..." if len(self.topics) > _SHOWN else ""
        return f"<{type(self).__name__} on {', '.join(map(visible, self.topics[:_SHOWN]))}{more} of {paths}>"


class Scans(Stream[Scan]):
    """The scans of a recording, read as they are iterated over; `pc2scan.scans` makes it.

    The recording is opened immediately, so that a wrong request raises here and not in the loop.
    Each loop reads from the beginning. The files are closed when the loop ends or is left, or with `close` or a
    ``with`` statement.

    Attributes
    ----------
    topics
        The topics of the scans.
    notes
        Values that were measured, or chosen by default, for scans that are made of clouds.
    transforms
        All transforms of the recording, if they were read for scans that are made of clouds; else None.
    damage
        The damage that the last loop found.
    skipped, skipped_count
        Messages that the last loop could not use: the first hundred, and how many.
    """

    _kinds = (LASERSCAN,)
    _hint = (
        CLOUDS,
        "its clouds become scans with parameters: `preset`, `params_file`, or any of them by name, `min_height=-0.3`",
    )

    def __init__(
        self,
        paths: Sequence[Path],
        request: Request,
        converting: bool = False,  # for pickles
        *,
        transform_frames: Collection[str] | None = None,
        all_topics: bool = False,
        meter: Meter | None = None,
    ) -> None:
        self._converting = converting
        self._transform_frames = transform_frames
        self.transforms: TransformBuffer | None = None
        super().__init__(paths, request, all_topics=all_topics, meter=meter)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._paths, self._options, self._converting)

    def _decoder(self, connection: Connection) -> Callable[[Buffer], LaserScan]:
        return partial(_decode, connection.serialization)

    def _object(self, topic: str, log_time_ns: int, message: Any) -> Scan:
        return Scan(topic, log_time_ns, *map(message.__getattribute__, _DECODED))

    def _source(self, stack: ExitStack, reader: Reader) -> StreamSource:
        """Return what is read; clouds are converted as `pc2scan.convert` does."""
        if not self._converting:
            return super()._source(stack, reader)
        options = self._options
        if not options.scan.topics and not self._all_topics:
            # Raises if there are several.
            self._choose(reader, options.scan.types(), _RECORDED)
        plan = make_plan(reader.connections, options)
        report = Report([str(path) for path in self._paths], "", plan.specs)
        report.warnings += (*plan.warnings, *request_warnings(options, reader.summary, reader.connections))
        prepared = prepare(
            reader,
            plan,
            options,
            span_of(reader, options),
            stack,
            partial(tell_early, report.warnings, None),
            transform_frames=self._transform_frames,
            meter=self._meter,
        )
        self.transforms = prepared.recorded and prepared.recorded.buffer
        report.add((), prepared.notes)
        self.notes = tuple(report.notes)
        prepared.routes, report.topics = equip_routes(plan, prepared.conversions, finish=_as_in_message)
        judge_first(prepared, report)

        def conclude() -> None:
            report.add(
                [label + text for label, surroundings in prepared.surroundings for text in surroundings.warnings()]
            )
            report.add(prepared.reader.remarks)
            report.add(*result_findings(report))

        return StreamSource(
            stack,
            [prepared.reader, *prepared.others],
            tuple(dict.fromkeys(target for route in plan.routes for target in route.targets)),
            prepared.routes,
            prepared.span,
            options.jobs,
            report.warnings,
            conclude,
        )


class Clouds(Stream[Cloud]):
    """The clouds of a recording, read as they are iterated over; `pc2scan.clouds` makes it.

    The recording is opened immediately, so that a wrong request raises here and not in the loop.
    Each loop reads from the beginning. The files are closed when the loop ends or is left, or with `close` or a
    ``with`` statement.

    Attributes
    ----------
    topics
        The topics of the clouds.
    damage
        The damage that the last loop found.
    skipped, skipped_count
        Messages that the last loop could not use: the first hundred, and how many.
    """

    _kinds, _hint = CLOUDS, ((LASERSCAN,), "it has LaserScan topics: pc2scan.scans() reads these")

    def _decoder(self, connection: Connection) -> Callable[[Buffer], PointCloud2]:
        decode = CLOUDS[connection.ros_type](connection.serialization)
        return lambda data: recorded_cloud(decode(own_data(data)))

    def _object(self, topic: str, log_time_ns: int, message: PointCloud2) -> Cloud:
        return Cloud(topic, log_time_ns, message)


def _step(decode: Callable[[Buffer], Any]) -> Callable[[Buffer], ConvertedMessage]:
    """Return the only step of messages that are read as they are."""
    return lambda data: ConvertedMessage(decode(data), NO_POINTS, empty=False, size=len(data))


def _decode(serialization: str, data: Buffer) -> LaserScan:
    """Return a scan that does not keep the message in memory."""
    scan = decode_laserscan(data, serialization)
    scan.ranges, scan.intensities = scan.ranges.astype(np.float32), scan.intensities.astype(np.float32)
    return scan


def _as_in_message(serialization: str, result: ConvertedMessage) -> ConvertedMessage:
    """Do the last step of a conversion to `Scan`: the numbers of the arrays become those of a message."""
    result.message = _decode(serialization, encode_laserscan(result.message, serialization))
    result.size = result.message.ranges.nbytes + result.message.intensities.nbytes
    return result
