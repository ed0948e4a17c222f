"""When transforms were logged: a message filter with a queue of one drops a scan whose transform is behind the next."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from contextlib import suppress
from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError
from pc2scan.messages.tfmessage import decode_transforms

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.model import RawMessage


class Arrivals:
    """The stamps of the transforms of each child frame, as far as they advance, and their log times."""

    def __init__(self) -> None:
        self._frames: dict[str, tuple[array[int], array[int]]] = {}

    def add(self, message: RawMessage) -> None:
        """Add the transforms of the next message."""
        with suppress(DecodeError):
            for _, child, stamp_ns, *_ in decode_transforms(message.data, message.connection.serialization):
                stamps, logged = self._frames.setdefault(child.removeprefix("/"), (array("q"), array("q")))
                if not stamps or stamp_ns > stamps[-1]:
                    stamps.append(stamp_ns)
                    logged.append(message.log_time_ns)

    def known_ns(self, children: Iterable[str], stamp_ns: int) -> int:
        """Return the log time from which on the transforms of some frames are known at a stamp; 0 without any."""
        latest = 0
        for child in children:
            stamps, logged = self._frames.get(child, ((), ()))
            place = bisect_left(stamps, stamp_ns)
            if place < len(stamps):
                latest = max(latest, logged[place])
        return latest
