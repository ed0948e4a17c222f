"""Reads the transforms of recordings, and stores them for processes that share the reading of a recording."""

from __future__ import annotations

import math
from contextlib import suppress
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from pc2scan.bags.topics import is_static
from pc2scan.errors import DecodeError, RecordingError, UsageError, name_list
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.model import copied_message
from pc2scan.text import counted, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.bags.observers import Observer
    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import TransformRow
    from pc2scan.model import Connection, RawMessage

    from .buffer import TransformBuffer
    from .placing import FrameOptions

#: Duration, and number of messages, of moving transforms that are read to find the transforms between a robot's frames.
_SOME_NS = 1_000_000_000
_SOME_MESSAGES = 1_000

#: A frame moves if its translations differ by this much, metres.
_MOVES = 0.05


def tf_connections(connections: Sequence[Connection], topics: Sequence[str] = ()) -> list[Connection]:
    """Return the connections with transforms.

    Parameters
    ----------
    topics
        Their topics; empty means ``/tf`` and ``/tf_static``, or those of the only namespace that has them.

    Raises
    ------
    UsageError
        If a topic has no transforms, or several namespaces have transforms and no topic is given.
    """
    candidates = [c for c in connections if c.ros_type in TF_TYPES and c.ros_version is not None]
    names = {c.topic.strip("/") for c in candidates}
    if topics:
        missing = [topic for topic in topics if topic.strip("/") not in names]
        if missing:
            known = [f"/{name}" for name in sorted(names)]
            near = did_you_mean(missing[0], known)
            hint = f"{near} topics with transforms: {name_list(known)}".strip()
            raise UsageError(f"no transforms on {missing[0]}", hint=hint)
        wanted = {topic.strip("/") for topic in topics}
        return [c for c in candidates if c.topic.strip("/") in wanted]
    spaces: dict[str, list[Connection]] = {}
    for c in candidates:
        namespace, _, name = c.topic.strip("/").rpartition("/")
        if name in ("tf", "tf_static"):
            spaces.setdefault(namespace, []).append(c)
    if "" in spaces or len(spaces) <= 1:
        return spaces.get("", next(iter(spaces.values()), []))
    raise UsageError(
        f"several robots have transforms: {', '.join(f'/{space}' for space in sorted(spaces))}",
        hint=f"choose one: `tf_topics=/{min(spaces)}/tf` `tf_topics=/{min(spaces)}/tf_static`",
    )


class TransformReading:
    """The transforms of recordings, with those that a user adds; while the recordings are read.

    Parameters
    ----------
    options
        Their topics, and the transforms to add.
    """

    def __init__(self, options: FrameOptions) -> None:
        from .builder import TransformBuilder  # noqa: PLC0415  # only with transforms

        self._options = options
        self._builder = TransformBuilder()
        self._warnings: dict[str, int] = {}
        # Added first, so that they replace the recording's: users add transforms because those are wrong or missing.
        self._builder.add((static.row(0) for static in options.static), static=True)
        self._overridden = {static.child.removeprefix("/") for static in options.static}

    def observers(self, reader: Reader) -> list[Observer[RawMessage]]:
        """Return the observer of all transforms of a recording, anywhere in the files; none if it has none.

        Raises
        ------
        UsageError
            If it is not clear which topics to use.
        """
        from pc2scan.bags.observers import Observer  # noqa: PLC0415  # only with transforms

        connections = tf_connections(reader.connections, self._options.tf_topics)
        first: dict[str, TransformRow] = {}
        return [Observer(connections, copied_message, keep=partial(self.add, reader, first))] if connections else []

    def add(self, reader: Reader, first: dict[str, TransformRow], message: RawMessage) -> None:
        """Add the transforms of a message, or count it if it cannot be decoded.

        ``first`` has the first transform of each child frame that the user's transforms replace.
        """
        connection, warnings = message.connection, self._warnings
        try:
            rows = decode_transforms(message.data, connection.serialization)
        except DecodeError as err:
            text = f"{connection.topic}: a transform message cannot be decoded: {err.message}"
            warnings[text] = warnings.get(text, 0) + 1
            return
        if self._overridden:
            for row in rows:
                parent, child, *_ = row
                if child.removeprefix("/") in self._overridden and _differs(row, first.setdefault(child, row)):
                    warnings[f"`static_tf` replaces the transforms of {child} in {parent}, which move"] = 1
            rows = [row for row in rows if row[1].removeprefix("/") not in self._overridden]
        try:
            self._builder.add(rows, static=is_static(connection.topic))
        except RecordingError as err:
            err.path, err.topic = reader.path, connection.topic
            raise

    def finish(self) -> tuple[TransformBuffer, list[str]]:
        """Return the transforms, and warnings: those that cannot be used, and messages that cannot be decoded."""
        buffer = self._builder.build()
        texts = [f"{text} ({count} times)" if count > 1 else text for text, count in self._warnings.items()]
        texts += [
            f"{counted(r.count, 'transform')} from {r.parent!r} to {r.child!r} not usable: {r.reason}"
            for r in buffer.rejections
        ]
        return buffer, texts


def read_transforms(
    readers: Sequence[Reader], options: FrameOptions, others: Sequence[Observer[Any]] = ()
) -> tuple[TransformBuffer, list[str]]:
    """Read all transforms of recordings, anywhere in the files, and add the user's own.

    Parameters
    ----------
    readers
        The source first, then the recordings of ``tf_from``.
    others
        What else observes the source.

    Returns
    -------
    TransformBuffer, list of str
        The transforms, and warnings: transforms that cannot be used, and messages that cannot be decoded.
    """
    from pc2scan.bags.observers import observe  # noqa: PLC0415  # only with transforms

    reading = TransformReading(options)
    for reader in readers:
        observe(reader, [*reading.observers(reader), *(others if reader is readers[0] else ())])
    return reading.finish()


def _differs(row: TransformRow, first: TransformRow) -> bool:
    """Whether the translations of two transforms with the same parent differ by more than measuring a mount does."""
    return row[0] == first[0] and math.dist(row[3:6], first[3:6]) > _MOVES


class RobotTransforms:
    """The transforms between a robot's frames: the static ones, and a second of the moving ones, or several.

    Parameters
    ----------
    reader
        The recording.
    options
        The topics, and the transforms to add.
    times_ns
        The log times at which the seconds begin.

    Attributes
    ----------
    observers
        Take them from the recording; none if it is not clear which topics to use.
    """

    def __init__(self, reader: Reader, options: FrameOptions, times_ns: Sequence[int]) -> None:
        self._reader = reader
        self._options = options
        self._is_known = True
        self.observers: list[Observer[RawMessage]] = []
        try:
            connections = tf_connections(reader.connections, options.tf_topics)
        except UsageError:
            self._is_known = False
            return
        from pc2scan.bags.observers import Observer  # noqa: PLC0415  # only with transforms

        static, moving = (
            [connection for connection in connections if is_static(connection.topic) is kind] for kind in (True, False)
        )
        if static:
            self.observers.append(Observer(static, copied_message, _SOME_MESSAGES))
        times_ns = sorted(set(times_ns)) if moving else []
        for begin_ns, next_ns in zip_longest(times_ns, times_ns[1:]):
            end_ns = begin_ns + _SOME_NS if next_ns is None else min(begin_ns + _SOME_NS, next_ns)
            self.observers.append(Observer(moving, copied_message, _SOME_MESSAGES, begin_ns, end_ns))

    def finish(self) -> TransformBuffer | None:
        """Return the transforms; None if there are none, or it is not clear which ones to use."""
        if not self._is_known or not (self.observers or self._options.static):
            return None
        reading = TransformReading(self._options)
        for observer in self.observers:
            for message in observer.found:
                with suppress(RecordingError):
                    reading.add(self._reader, {}, message)
        buffer, _ = reading.finish()
        return buffer if len(buffer) else None


def read_robot_transforms(reader: Reader, options: FrameOptions, time_ns: int) -> TransformBuffer | None:
    """Read the transforms between a robot's frames; see `RobotTransforms`."""
    from pc2scan.bags.observers import observe  # noqa: PLC0415  # only with transforms

    robot = RobotTransforms(reader, options, [time_ns])
    observe(reader, robot.observers)
    return robot.finish()
