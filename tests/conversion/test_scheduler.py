from __future__ import annotations

from functools import partial
from threading import current_thread, main_thread
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from pc2scan.advice.survey import Span
from pc2scan.bags.loading import Chunk
from pc2scan.conversion import engine
from pc2scan.conversion.items import Item
from pc2scan.conversion.plan import Output, Route
from pc2scan.conversion.steps import ConvertedMessage, Steps
from pc2scan.core.rule import PointCounts
from pc2scan.model import Connection, RawMessage
from pc2scan.threads import Threads

if TYPE_CHECKING:
    from collections.abc import Callable

TOPIC = Connection(1, "/a", "a/msg/A", "cdr")


def test_a_result_that_takes_more_memory_is_made_in_its_turn() -> None:
    made: list[int] = []

    def convert(data: Any) -> ConvertedMessage:
        assert current_thread() is main_thread()
        made.append(len(data))
        return ConvertedMessage(b"cloud", PointCounts(), empty=False)

    def load(number: int, callback: Callable[[RawMessage], Any]) -> list[Any]:
        return [callback(RawMessage(TOPIC, number, b"a", 0))]

    reader: Any = SimpleNamespace(
        path=None,
        summary=SimpleNamespace(size_bytes=0),
        chunks=lambda *_: [Chunk(number, (number,), 1, partial(load, number)) for number in range(9)],
    )
    route = Route(TOPIC, [Output(None, "/cloud")], steps=[Steps(None, None, convert)], shrinks_from=1 << 30)
    with Threads(2) as threads:
        for number, item in enumerate(engine.items_of(reader, {1: route}, Span(None, None, 0), threads)):
            assert isinstance(item, Item)
            assert len(made) == number + 1
