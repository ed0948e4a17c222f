"""A recording in memory, for what is done with readers whatever they read."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

from pc2scan.bags.reader import Chunk, Reader
from pc2scan.model import RawMessage, Summary

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Wanted
    from pc2scan.model import Connection


def _load(message: RawMessage, callback: Callable[[RawMessage], Any]) -> list[Any]:
    return [callback(message)]


class MemoryReader(Reader):
    """Reads (connection id, log time, data), each a unit of its own; `log` notes when it begins and ends to read."""

    path: Path = None  # type: ignore[assignment]
    connections: Sequence[Connection] = ()
    summary: Summary = None  # type: ignore[assignment]
    damage = ()

    def __init__(
        self,
        path: Path,
        connections: Sequence[Connection],
        rows: Sequence[tuple[int, int, bytes]],
        *,
        container: str = "mcap",
        knows_times: bool = True,
        log: list[str] | None = None,
    ) -> None:
        self.path, self.connections, self.rows = path, connections, sorted(rows, key=lambda row: row[1])
        times = [time_ns for _, time_ns, _ in rows] if knows_times else []
        span = min(times, default=None), max(times, default=None)
        self.summary = Summary(container, "", ("none",), 10, len(rows), *span)
        self.log = [] if log is None else log

    def is_wanted(
        self, connections: Collection[Connection] | None, start_ns: int | None, stop_ns: int | None
    ) -> Callable[[tuple[int, int, bytes]], bool]:
        """What finds out whether a row is of these connections and times."""
        known = {each.id for each in (self.connections if connections is None else connections)}
        times = -math.inf if start_ns is None else start_ns, math.inf if stop_ns is None else stop_ns
        return lambda row: row[0] in known and times[0] <= row[1] < times[1]

    def chunks(self, wanted: Wanted) -> Iterator[Chunk]:
        connections, start_ns, stop_ns, rule = wanted
        assert rule is None, "there are no chunks to be copied"
        self.log.append(f"open {self.path.name}")
        known = {each.id: each for each in (self.connections if connections is None else connections)}
        is_wanted = self.is_wanted(connections, start_ns, stop_ns)
        try:
            for place, row in enumerate(self.rows):
                if is_wanted(row):
                    number, time_ns, data = row
                    message = RawMessage(known[number], time_ns, data, time_ns, 7)
                    load, ids = partial(_load, message), frozenset([number])
                    yield Chunk(time_ns, (place,), len(data), load, end_ns=time_ns, connection_ids=ids)
        finally:
            self.log.append(f"close {self.path.name}")

    def counts(
        self, connections: Collection[Connection], start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[int, int]:
        """Count as a container that cannot do it without reading."""
        del connections, start_ns, stop_ns
        return {}

    def close(self) -> None:
        self.log.append(f"closed {self.path.name}")
