"""Finds names in a recording quickly, for the shell's completion."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from pc2scan.bags.opening import open_recordings
from pc2scan.messages.tfmessage import decode_transforms
from pc2scan.transforms.reading import tf_connections

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path


def topics_in(paths: Iterable[Path], endings: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the topics of recordings, of types with these endings, or of any type."""
    with ExitStack() as stack:
        for reader in open_recordings(paths, stack):
            for connection in reader.connections:
                if not endings or connection.ros_type.endswith(endings):
                    yield connection.topic


def frames_in(paths: Iterable[Path], tf_topics: Sequence[str] = ()) -> Iterator[str]:
    """Yield the frames of the transforms in recordings, as they are read, each as often as it occurs."""
    with ExitStack() as stack:
        for reader in open_recordings(paths, stack):
            for message in reader.messages(tf_connections(reader.connections, tf_topics)):
                for parent, child, *_ in decode_transforms(message.data, message.connection.serialization):
                    yield parent
                    yield child
