"""Reads the messages of a recording one after the other: opens it, applies the cut, and closes it."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from contextlib import ExitStack, closing, suppress
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar
from weakref import WeakSet, finalize

import numpy as np

from pc2scan.bags.damage import mention
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import by_topic, find_topics, short_types, types_by_topic
from pc2scan.conversion.corrections import corrected, scaled
from pc2scan.conversion.engine import items_of
from pc2scan.conversion.items import Tally
from pc2scan.conversion.plan import Output, Route
from pc2scan.conversion.preparation import span_of
from pc2scan.conversion.report import TopicReport
from pc2scan.conversion.source_checks import refuse_no_messages
from pc2scan.conversion.steps import ConvertedMessage, as_it_is
from pc2scan.core.rule import NO_POINTS
from pc2scan.errors import NothingToConvertError, Pc2ScanError, RecordingWarning, TopicError, name_list, visible
from pc2scan.messages.clouds import usual_topics
from pc2scan.messages.other_clouds import without
from pc2scan.model import StoredChunk
from pc2scan.threads import Threads, cores

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Mapping, Sequence
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

    from pc2scan.advice.survey import Span
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.conversion.items import Item as EngineItem
    from pc2scan.errors import MessageError
    from pc2scan.model import Buffer, Connection
    from pc2scan.progress import Meter
    from pc2scan.request.options import ConvertOptions
    from pc2scan.result import Skipped
    from pc2scan.transforms.placing import LevelTransform

#: The smallest of 64 bits is NumPy's "not a time".
_MAX_INT64 = 2**63 - 1

#: How many topics ``repr`` names.
_SHOWN = 3

Item = TypeVar("Item")


def datetime64(nanoseconds: int) -> np.datetime64:
    """Return nanoseconds since 1970 as ``numpy.datetime64``; ``NaT`` for values beyond 64 bits."""
    return np.datetime64(nanoseconds, "ns") if abs(nanoseconds) <= _MAX_INT64 else np.datetime64("NaT", "ns")


class Message:
    """A message whose times are also NumPy's."""

    __slots__ = ()

    @property
    def stamp(self: Any) -> np.datetime64:
        """``header.stamp`` as ``numpy.datetime64`` in nanoseconds."""
        return datetime64(self.stamp_ns)

    @property
    def log_time(self: Any) -> np.datetime64:
        """The time of recording as ``numpy.datetime64`` in nanoseconds; ``NaT`` if that cannot represent it."""
        return datetime64(self.log_time_ns)


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
        What is done with the messages of each connection.
    span
        The cut.
    jobs
        The number of threads; 0: one for each processor core.
    warnings
        Those of a conversion, which adds more while it is read.
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


class StreamedResult(NamedTuple):
    """What a message became: its objects, with the transform of a level scan's frame, or the errors in their place."""

    topic: str
    items: Sequence[tuple[Any, LevelTransform | None]]
    errors: Sequence[MessageError]


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
        self, paths: Sequence[Path], options: ConvertOptions, *, all_topics: bool = False, meter: Meter | None = None
    ) -> None:
        self._paths = tuple(paths)
        self._options = options
        self.strict = options.strict
        self._all_topics = all_topics
        self._meter = meter
        self._live: WeakSet[Generator[Item]] = WeakSet()
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

    @abstractmethod
    def _source(self, stack: ExitStack, reader: Reader) -> StreamSource:
        """Return what is read from an open recording."""

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
        instead = hint[1] if any(each.ros_type in hint[0] for each in reader.connections) else None
        if not chosen:
            message, other = without(short_types(kinds), reader.connections)
            raise NothingToConvertError(message, path=reader.path, hint=instead or other or None)
        if requested := self._options.scan.topics:
            try:
                names = [name for each in requested for name in find_topics(each.source, types, sorted(chosen), *kinds)]
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

    def _recorded(
        self,
        stack: ExitStack,
        reader: Reader,
        kinds: Collection[str],
        hint: tuple[Collection[str], str],
        decoder: Callable[[Connection], Callable[[Buffer], Any]],
    ) -> StreamSource:
        """Return the messages of some types as they are; see `_choose`. ``decoder`` returns that of a connection."""
        options = self._options
        chosen = self._choose(reader, kinds, hint)
        span = span_of(reader, options)
        if options.clock:
            wanted = [connection for connections in chosen.values() for connection in connections]
            reader, notes = corrected(reader, wanted, options.clock, (), span)
            self.notes = tuple(notes)
        routes = {}
        for topic, connections in chosen.items():
            output = Output(None, topic, report=TopicReport(topic, connections[0].ros_type, topic, "converted"))
            for connection in connections:
                decode = _step(decoder(connection))
                # A message is decoded at once: its object takes no more memory.
                routes[connection.id] = Route(connection, [output], decode=decode, steps=[(as_it_is,)])
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
        items = self._items(self.results())
        self._live.add(items)
        # From here on the generator closes the files in any case.
        next(items)
        return items

    def _items(self, results: Generator[StreamedResult]) -> Generator[Item]:
        """Yield the objects, after a first None."""
        with closing(results):
            yield None  # type: ignore[misc]
            # What is kept in memory ends with the loop's own reference to it.
            for result in results:
                objects = result.items
                del result
                for item, _ in objects:
                    yield item
                    del item
                del objects

    def results(self) -> Generator[StreamedResult]:
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
        next(results)
        return results

    def _results(self, source: StreamSource) -> Generator[StreamedResult]:
        """Yield what each message becomes, after a first None: from then on the files are closed in any case."""
        with source.stack as stack:
            yield None  # type: ignore[misc]
            tally = Tally(source.routes, strict=self.strict)
            self.skipped, self.skipped_count = tally.skipped, 0
            self.damage = source.damage
            warned = self._warn_of_damage(0)
            told = 0
            meter, self._meter = self._meter, None
            jobs = source.jobs or cores()
            items = items_of(
                source.readers[0],
                source.routes,
                source.span,
                stack.enter_context(Threads(jobs)) if jobs > 1 else None,
                window=self._options.window,
                meter=meter,
            )
            stack.enter_context(closing(items))
            try:
                told = self._warn(source.warnings)
                for item in items:
                    # No rule allows whole chunks here.
                    assert not isinstance(item, StoredChunk)
                    tally.count(item)
                    if self.listener is None and self.skipped_count == 0 < tally.failures:
                        error = item.errors[0]
                        hint = f" ({error.hint})" if error.hint else ""
                        self._warn([f"skipped: {error}{hint}; see .skipped for all; strict=True makes them errors"])
                    self.skipped_count = tally.failures
                    told = self._warn(source.warnings, told)
                    result = StreamedResult(item.route.connection.topic, self._objects(item), item.errors)
                    del item
                    yield result
                    del result
                tally.finish()
            except Pc2ScanError:
                # Often the cause.
                self._warn(source.warnings, told)
                raise
            source.conclude()
            self._warn(source.warnings, told)
            self.damage = source.damage
            self._warn_of_damage(warned)

    def _objects(self, item: EngineItem) -> list[tuple[Item, LevelTransform | None]]:
        """Return the objects of a message, each with the transform of a level scan's frame."""
        return [
            (self._object(output.report.target or "", item.log_time_ns, result.message), result.level)
            for output, result in item.results
            if isinstance(result, ConvertedMessage)
        ]

    def _warn(self, texts: Sequence[str], told: int = 0, depth: int = 4) -> int:
        """Pass on the texts after those that were told: to `listener`, or as warnings about the line of the loop."""
        for text in texts[told:]:
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
        for items in tuple(self._live):
            items.close()
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


def _step(decode: Callable[[Buffer], Any]) -> Callable[[Buffer], ConvertedMessage]:
    """Return the only step of messages that are read as they are."""
    return lambda data: ConvertedMessage(decode(data), NO_POINTS, empty=False, size=len(data))
