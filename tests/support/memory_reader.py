"""A recording in memory, for what is done with readers whatever they read."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from pc2scan.bags.reader import Reader
from pc2scan.bags.units import Unit
from pc2scan.model import RawMessage, Summary

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from pc2scan.model import ChunkRule, Connection

__all__ = ["MemoryReader"]


def _load(message: RawMessage, callback: Callable[[RawMessage], Any], *, whole: bool) -> list[Any]:
    assert not whole, "there are no chunks"
    return [callback(message)]


class MemoryReader(Reader):
    """Reads (connection id, log time, data), each a unit of its own; `log` notes when it begins and ends to read."""

    path: Path = None  # type: ignore[assignment]
    connections: Sequence[Connection] = ()
    summary: Summary = None  # type: ignore[assignment]
    bytes_read = 3
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

    def units(
        self,
        connections: Collection[Connection] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        rule: ChunkRule | None = None,
    ) -> Iterator[Unit]:
        assert rule is None, "there are no chunks to be copied"
        self.log.append(f"open {self.path.name}")
        known = {each.id: each for each in (self.connections if connections is None else connections)}
        try:
            for place, (number, time_ns, data) in enumerate(self.rows):
                wanted = number in known and (start_ns is None or start_ns <= time_ns)
                if wanted and (stop_ns is None or time_ns < stop_ns):
                    message = RawMessage(known[number], time_ns, data, time_ns, 7)
                    yield Unit(time_ns, (place,), len(data), partial(_load, message))
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
