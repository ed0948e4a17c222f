"""Small recordings of transforms in memory, and the frames that a conversion makes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import Connection
from pc2scan.transforms.placing import FrameOptions, Placer
from pc2scan.transforms.reading import read_transforms
from support.memory_reader import MemoryReader

TF = "tf2_msgs/TFMessage"


def connection(number: int, topic: str, kind: str = TF) -> Connection:
    return Connection(number, topic, kind, "ros1")


def made(*messages: tuple[str, Any]) -> MemoryReader:
    """A recording of topics with rows of transforms, or with bytes."""
    topics = list(dict.fromkeys(topic for topic, _ in messages))
    rows = [
        (topics.index(topic), place, rows if isinstance(rows, bytes) else encode_transforms(rows, "ros1"))
        for place, (topic, rows) in enumerate(messages)
    ]
    return MemoryReader(Path("made"), [connection(i, topic) for i, topic in enumerate(topics)], rows)


def row(parent: str, child: str, stamp_ns: int, x: float) -> tuple[Any, ...]:
    return (parent, child, stamp_ns, x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def frames(recordings: list[Any], options: FrameOptions | None = None, **kwargs: Any) -> tuple[Placer, list[str]]:
    options = options or FrameOptions()
    buffer, warnings, *_ = read_transforms(recordings, options)
    return Placer(kwargs.get("target", "base"), options.source_frame, buffer, kwargs.get("tolerance_ns", 0)), warnings
