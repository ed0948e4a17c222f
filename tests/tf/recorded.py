"""Small recordings of transforms in memory, and the frames that a conversion makes of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import Connection, RawMessage
from pc2scan.tf.options import FrameOptions
from pc2scan.tf.placing import Placer
from pc2scan.tf.reading import read_transforms

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Recording", "connection", "frames", "row"]

TF = "tf2_msgs/TFMessage"


def connection(number: int, topic: str, kind: str = TF) -> Connection:
    return Connection(number, topic, kind, "ros1")


class Recording:
    """The part of a reader that transforms are read through."""

    def __init__(self, *messages: tuple[str, Any]) -> None:
        topics = list(dict.fromkeys(topic for topic, _ in messages))
        self.connections = [connection(i, topic) for i, topic in enumerate(topics)]
        by_topic = {c.topic: c for c in self.connections}
        self._messages = [
            RawMessage(by_topic[topic], i, rows if isinstance(rows, bytes) else encode_transforms(rows, "ros1"), i)
            for i, (topic, rows) in enumerate(messages)
        ]

    def messages(
        self, connections: list[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        assert start_ns is stop_ns is None
        wanted = {c.id for c in connections}
        return (m for m in self._messages if m.connection.id in wanted)


def row(parent: str, child: str, stamp_ns: int, x: float) -> tuple[Any, ...]:
    return (parent, child, stamp_ns, x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def frames(recordings: list[Any], options: FrameOptions | None = None, **kwargs: Any) -> tuple[Placer, list[str]]:
    options = options or FrameOptions()
    buffer, warnings = read_transforms(recordings, options)
    return Placer(kwargs.get("target", "base"), options.source_frame, buffer, kwargs.get("tolerance_ns", 0)), warnings
