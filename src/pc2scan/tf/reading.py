"""Reads the transforms of recordings, and stores them for processes that share the reading of a recording."""

from __future__ import annotations

import math
from itertools import islice
from typing import TYPE_CHECKING

from pc2scan.bags.latching import is_static
from pc2scan.errors import DecodeError, RecordingError, UsageError, name_list
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.text import counted, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import TransformRow
    from pc2scan.model import Connection

    from .buffer import TransformBuffer
    from .builder import TransformBuilder
    from .options import FrameOptions

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


def read_transforms(readers: Iterable[Reader], options: FrameOptions) -> tuple[TransformBuffer, list[str]]:
    """Read all transforms of recordings, anywhere in the files, and add the user's own.

    Parameters
    ----------
    readers
        The sources first, then the recordings of ``tf_from``.

    Returns
    -------
    TransformBuffer, list of str
        The transforms, and warnings: transforms that cannot be used, and messages that cannot be decoded.
    """
    from .builder import TransformBuilder  # noqa: PLC0415  # only with transforms

    builder, warnings = TransformBuilder(), dict[str, int]()
    # Added first, so that they replace the recording's: users add transforms because those are wrong or missing.
    builder.add((static.row(0) for static in options.static), static=True)
    for reader in readers:
        _collect_transforms(reader, options, builder, warnings)
    buffer = builder.build()
    texts = [f"{text} ({count} times)" if count > 1 else text for text, count in warnings.items()]
    texts += [
        f"{counted(r.count, 'transform')} from {r.parent!r} to {r.child!r} not usable: {r.reason}"
        for r in buffer.rejections
    ]
    return buffer, texts


def _collect_transforms(
    reader: Reader, options: FrameOptions, builder: TransformBuilder, warnings: dict[str, int]
) -> None:
    """Add a recording's transforms, and count what cannot be decoded."""
    connections = tf_connections(reader.connections, options.tf_topics)
    if not connections:
        return
    overridden = {static.child.removeprefix("/") for static in options.static}
    first: dict[str, TransformRow] = {}
    for message in reader.messages(connections):
        connection = message.connection
        try:
            rows = decode_transforms(message.data, connection.serialization)
        except DecodeError as err:
            text = f"{connection.topic}: a transform message cannot be decoded: {err.message}"
            warnings[text] = warnings.get(text, 0) + 1
            continue
        if overridden:
            for row in rows:
                parent, child, *_ = row
                if child.removeprefix("/") in overridden and _differs(row, first.setdefault(child, row)):
                    warnings[f"`static_tf` replaces the transforms of {child} in {parent}, which move"] = 1
            rows = [row for row in rows if row[1].removeprefix("/") not in overridden]
        try:
            builder.add(rows, static=is_static(connection.topic))
        except RecordingError as err:
            err.path, err.topic = reader.path, connection.topic
            raise


def _differs(row: TransformRow, first: TransformRow) -> bool:
    """Whether the translations of two transforms with the same parent differ by more than measuring a mount does."""
    return row[0] == first[0] and math.dist(row[3:6], first[3:6]) > _MOVES


def read_some_transforms(reader: Reader, options: FrameOptions, time_ns: int) -> TransformBuffer | None:
    """Read the transforms between a robot's frames: the static ones, and a second of the moving ones.

    Returns
    -------
    TransformBuffer or None
        None if there are no transforms, or it is not clear which ones to use.
    """
    try:
        connections = tf_connections(reader.connections, options.tf_topics)
    except UsageError:
        return None
    if not connections and not options.static:
        return None
    from .builder import TransformBuilder  # noqa: PLC0415  # few recordings need it

    builder = TransformBuilder()
    builder.add((static.row(0) for static in options.static), static=True)
    overridden = {static.child.removeprefix("/") for static in options.static}
    for static, start_ns, stop_ns in ((True, None, None), (False, time_ns, time_ns + _SOME_NS)):
        group = [connection for connection in connections if is_static(connection.topic) is static]
        if not group:
            continue
        for message in islice(reader.messages(group, start_ns, stop_ns), _SOME_MESSAGES):
            try:
                rows = decode_transforms(message.data, message.connection.serialization)
                builder.add([row for row in rows if row[1].removeprefix("/") not in overridden], static=static)
            except (DecodeError, RecordingError):
                continue
    buffer = builder.build()
    return buffer if len(buffer) else None
