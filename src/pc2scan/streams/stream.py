"""Reads the messages of a recording one after the other: opens it, applies the cut, and closes it."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar
from weakref import WeakSet, finalize

import numpy as np

from pc2scan.bags.damage import mention
from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.topics import find_topics, short_types
from pc2scan.conversion.cloud_scale import scaled
from pc2scan.conversion.engine import items_of
from pc2scan.conversion.items import OpenRoute, Output, Tally
from pc2scan.conversion.preparation import span_of
from pc2scan.conversion.refusals import refuse_no_messages
from pc2scan.conversion.report import TopicReport
from pc2scan.conversion.stamps import corrected
from pc2scan.conversion.steps import ConvertedMessage
from pc2scan.core.rule import NO_POINTS
from pc2scan.errors import (
    NothingToConvertError,
    Pc2ScanError,
    RecordingWarning,
    TopicError,
    name_list,
    visible,
)
from pc2scan.messages.clouds import usual_topics
from pc2scan.messages.other_clouds import without
from pc2scan.model import StoredChunk
from pc2scan.request.options import ConvertOptions, StampOptions
from pc2scan.threads import Threads, cores

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Mapping, Sequence
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

    from pc2scan.advice.survey import Span
    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.conversion.combine.combiner import Combiner
    from pc2scan.conversion.items import Item as EngineItem
    from pc2scan.errors import MessageError
    from pc2scan.model import Buffer, Connection
    from pc2scan.options.moment import TimeBound
    from pc2scan.progress import Meter
    from pc2scan.result import Skipped
    from pc2scan.transforms.placing import LevelTransform


def import_pandas() -> Any:
    """Return the package pandas; raise an ImportError with what to install if it is missing."""
    return _package("pandas", "to_dataframe")


def import_xarray() -> Any:
    """Return the package xarray; raise an ImportError with what to install if it is missing."""
    return _package("xarray", "to_xarray")


def _package(name: str, method: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as err:
        if err.name != name:
            raise
        raise ImportError(f"{method}() needs the package {name}: pip install {name}", name=name) from err


#: The smallest of 64 bits is NumPy's "not a time".
_MAX_INT64 = 2**63 - 1


def datetime64(nanoseconds: int) -> np.datetime64:
    """Return nanoseconds since 1970 as ``numpy.datetime64``; ``NaT`` for values beyond 64 bits."""
    return np.datetime64(nanoseconds, "ns") if abs(nanoseconds) <= _MAX_INT64 else np.datetime64("NaT", "ns")


class NumpyTimes:
    """A message whose times are also NumPy's."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def log_time_ns(self) -> int:
            """The time of recording, nanoseconds since 1970."""

        @property
        def stamp_ns(self) -> int:
            """``header.stamp``, nanoseconds since 1970."""

    @property
    def stamp(self) -> np.datetime64:
        """``header.stamp`` as ``numpy.datetime64`` in nanoseconds."""
        return datetime64(self.stamp_ns)

    @property
    def log_time(self) -> np.datetime64:
        """The time of recording as ``numpy.datetime64`` in nanoseconds; ``NaT`` if that cannot represent it."""
        return datetime64(self.log_time_ns)


Item = TypeVar("Item")

#: How many topics ``repr`` names.
_SHOWN = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The messages that are requested.

    Attributes
    ----------
    paths
        Recordings; several are read as one.
    topics
        The requested topics; empty means the only one of its type.
    start, end
        The cut, by log time.
    strict
        Whether damage, and a message that cannot be used, are errors.
    clock
        How stamps are corrected; None: they are not.
    cloud_scale
        What the coordinates of clouds are multiplied by.
    """

    paths: tuple[Path, ...]
    topics: tuple[str, ...] = ()
    start: TimeBound | None = None
    end: TimeBound | None = None
    strict: bool = False
    clock: StampOptions | None = None
    cloud_scale: float = 1.0

    def select_connections(
        self, reader: Reader, kinds: Collection[str], hint: Callable[[Reader], str | None]
    ) -> dict[str, list[Connection]]:
        """Return the connections of the topics to read, by topic.

        Parameters
        ----------
        reader
            The recording.
        kinds
            The types of the topics, in ROS 2's spelling.
        hint
            Returns the hint for a recording without such topics.

        Raises
        ------
        TopicError
            If a topic is missing or has another type, or if none was requested and there is not exactly one.
        """
        types: dict[str, set[str]] = {}
        found: dict[str, list[Connection]] = {}
        for connection in reader.connections:
            types.setdefault(connection.topic, set()).add(connection.ros_type)
            if connection.ros_type in kinds and connection.ros_version is not None:
                found.setdefault(connection.topic, []).append(connection)
        if not found:
            message, other = without(short_types(kinds), reader.connections, reader)
            raise NothingToConvertError(message, path=reader.path, hint=hint(reader) or other or None)
        if not self.topics:
            found = {topic: found[topic] for topic in usual_topics({topic: types[topic] for topic in found}, kinds)}
        if not self.topics and len(found) > 1:
            raise TopicError(
                f"the recording has {len(found)} {short_types(kinds)} topics: {name_list(sorted(found))}",
                path=reader.path,
                hint=f'choose: topics="{min(found)}", or a list of several',
            )
        try:
            requested = [find_topics(topic, types, sorted(found), *kinds) for topic in self.topics]
            names = list(dict.fromkeys(name for several in requested for name in several)) or list(found)
        except TopicError as err:
            err.path = reader.path
            if names_a_type := hint(reader):
                err.hint = names_a_type
            raise
        return {name: found[name] for name in dict.fromkeys(names)}


class ConversionWarnings(Protocol):
    """Collects the warnings of a conversion."""

    def new(self) -> Sequence[str]:
        """Return those that are new since the last call."""
        ...

    def conclude(self) -> Sequence[str]:
        """Return the last ones, at the end."""
        ...


class StreamSource(NamedTuple):
    """An open recording, ready to be read.

    Attributes
    ----------
    readers
        The recording, and others that were opened for it; all are closed with ``stack``.
    topics
        The topics of the items.
    routes
        What is done with the messages of each connection.
    span
        The cut.
    warnings
        The warnings of a conversion; None if messages are read as they are.
    jobs
        The number of threads; 0: one for each processor core.
    combiners
        What makes scans of several messages, by the outputs of these.
    window
        How many units may be loaded ahead; None: as many as memory allows.
    """

    stack: ExitStack
    readers: Sequence[Reader]
    topics: tuple[str, ...]
    routes: Mapping[int, OpenRoute]
    span: Span
    warnings: ConversionWarnings | None = None
    jobs: int = 0
    combiners: Mapping[Output, Combiner] = {}
    window: int | None = None

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

    Attributes
    ----------
    topics
        The topics that are read.
    damage
        The damage that the last loop found.
    skipped
        The first hundred messages that the last loop could not use.
    skipped_count
        How many these were.
    notes
        Values that were measured, or chosen by default.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, selection: Selection, meter: Meter | None = None) -> None:
        self._selection = selection
        #: Counts the bytes of preparing, and of the first loop; None: nothing is reported.
        self._meter = meter
        self._live: WeakSet[Generator[Item]] = WeakSet()
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

    def _source_of_type(
        self,
        stack: ExitStack,
        reader: Reader,
        kinds: Collection[str],
        hint: Callable[[Reader], str | None],
        decoder: Callable[[Connection], Callable[[Buffer], Any]],
    ) -> StreamSource:
        """Return the messages of some types, each of which becomes one object; see `Selection.select_connections`.

        ``decoder`` returns the decoder of a connection's messages.
        """
        selection = self._selection
        chosen = selection.select_connections(reader, kinds, hint)
        span = span_of(reader, ConvertOptions(start=selection.start, end=selection.end))
        if selection.clock:
            wanted = [each for connections in chosen.values() for each in connections]
            reader, notes = corrected(reader, wanted, selection.clock, (), start_ns=span.start_ns, stop_ns=span.stop_ns)
            self.notes = tuple(notes)
        routes = {}
        for topic, connections in chosen.items():
            output = Output(TopicReport(topic, connections[0].ros_type, topic, "converted"), 0)
            for each in connections:
                step = partial(_as_recorded, decoder(each))
                # A message is decoded at once: its object takes no more memory.
                routes[each.id] = OpenRoute(each, steps=[step], outputs=[output], shrinks_from=0)
        # Objects are as large as their messages: other threads would hold many of them ahead of the loop.
        return StreamSource(stack, [reader], tuple(chosen), routes, span, jobs=1)

    def _open(self) -> StreamSource:
        selection = self._selection
        with ExitStack() as stack:
            readers = open_recordings(selection.paths, stack, strict=selection.strict)
            reader = as_one(readers)
            if selection.cloud_scale != 1:
                reader = scaled(reader, selection.cloud_scale)
            try:
                source = self._source(stack, reader)
            except TopicError as err:
                mention(reader.damage, err)
                raise
            # A topic without messages gives an empty loop, but a cut outside of the recording is an error.
            start_ns, stop_ns, _ = source.span
            connections = [route.connection for route in source.routes.values()]
            if self._meter is not None:
                self._meter.following = source.readers[0].stored_bytes(connections, start_ns, stop_ns)
            if start_ns is not None or stop_ns is not None:
                with suppress(TopicError):
                    refuse_no_messages(source.readers[0], connections, start_ns, stop_ns)
            # No error: the files stay open.
            return source._replace(stack=stack.pop_all())

    def __iter__(self) -> Generator[Item]:
        items = self._items(self._take_source())
        self._live.add(items)
        # From here on the generator closes the files in any case.
        next(items)
        return items

    def results(self) -> Generator[StreamedResult]:
        """Yield what each message became, for callers that report errors themselves.

        Raises
        ------
        MessageError
            If it is certain that no message can be used.
        """
        source = self._take_source()
        with source.stack, closing(self._read(source)) as items:
            for item in items:
                yield StreamedResult(item.route.connection.topic, self._objects(item), item.errors)
                del item
            self.damage = source.damage

    def _read(self, source: StreamSource) -> Generator[EngineItem]:
        """Yield the engine's items, after they were counted."""
        tally = Tally(source.routes, strict=self._selection.strict)
        self.skipped, self.skipped_count = tally.skipped, 0
        jobs = source.jobs or cores()
        meter, self._meter = self._meter, None
        with ExitStack() as stack:
            threads = stack.enter_context(Threads(jobs)) if jobs > 1 else None
            found = items_of(
                source.readers[0],
                source.routes,
                source.span,
                threads,
                combiners=source.combiners,
                window=source.window,
                meter=meter,
            )
            stack.enter_context(closing(found))
            try:
                self._warn(source)
                for item in found:
                    # No rule allows whole chunks here.
                    assert not isinstance(item, StoredChunk)
                    tally.count(item)
                    self.skipped_count = tally.failures
                    self._warn(source)
                    yield item
                    del item
                tally.finish()
            except Pc2ScanError:
                # Often the cause.
                self._warn(source)
                raise
        self._warn(source, at_end=True)

    def _warn(self, source: StreamSource, *, at_end: bool = False) -> None:
        """Pass on new warnings of a conversion: to `listener`, or as Python's warnings about the line of the loop."""
        if source.warnings is not None:
            for text in source.warnings.conclude() if at_end else source.warnings.new():
                if self.listener is not None:
                    self.listener(text)
                else:
                    warnings.warn(text, RecordingWarning, stacklevel=4)

    def _objects(self, item: EngineItem) -> list[tuple[Item, LevelTransform | None]]:
        """Return the objects of a message, each with the transform of a level scan's frame."""
        return [
            (self._object(output.report.target or "", item.log_time_ns, result.message), result.level)
            for output, result in item.results
            if isinstance(result, ConvertedMessage)
        ]

    def _take_source(self) -> StreamSource:
        """Return the open recording; the caller closes it."""
        source, self._prepared = self._prepared, None
        if source is None:
            return self._open()
        self._release.detach()
        return source

    def _items(self, source: StreamSource) -> Generator[Item]:
        """Yield the objects, after a first None: once the generator has begun, it closes the files in any case."""
        with source.stack:
            yield None  # type: ignore[misc]
            self.damage = source.damage
            warned = 0 if self.listener else _warn_of_damage(self.damage, 0)
            with closing(self._read(source)) as items:
                for item in items:
                    if self.skipped_count == 1 and not self.listener and item.errors:
                        error = item.errors[0]
                        hint = f" ({error.hint})" if error.hint else ""
                        more = "see .skipped for all such messages; strict=True makes them errors"
                        warnings.warn(f"skipped: {error}{hint}; {more}", RecordingWarning, stacklevel=2)
                    objects = self._objects(item)
                    del item
                    for each, _ in objects:
                        yield each
                        del each
                    del objects
            self.damage = source.damage
            if not self.listener:
                _warn_of_damage(self.damage, warned)

    def __reduce__(self) -> tuple[object, ...]:
        """Return how to open the recording anew, for copies, and for processes that read it, too."""
        return type(self), (self._selection,)

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
        paths = ", ".join(repr(str(path)) for path in self._selection.paths)
        more = ", ..." if len(self.topics) > _SHOWN else ""
        return f"<{type(self).__name__} on {', '.join(map(visible, self.topics[:_SHOWN]))}{more} of {paths}>"


def _as_recorded(decode: Callable[[Buffer], Any], data: Buffer) -> ConvertedMessage:
    """Return a message as it was recorded, in the form of the result of a conversion."""
    return ConvertedMessage(decode(data), NO_POINTS, empty=False, size=len(data))


def _warn_of_damage(damage: tuple[Damage, ...], warned: int) -> int:
    """Warn of damage that has not been reported yet; return how many places there are now."""
    if len(damage) > warned:
        first = damage[0]
        place = f"{first.path}" + ("" if first.offset is None else f", byte {first.offset}")
        more = f" and {len(damage) - 1} more places" if len(damage) > 1 else ""
        text = (
            f"damaged: {place}: {first.what}{more}; see .damage. The rest is read; strict=True refuses such recordings"
        )
        warnings.warn(text, RecordingWarning, stacklevel=3)
    return len(damage)
