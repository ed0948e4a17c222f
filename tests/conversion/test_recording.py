"""Several publishers of a topic, for a destination that has one connection a topic."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pc2scan.conversion.recording import declare
from pc2scan.model import Connection, Definition
from support.tables import rows


class Recorded:
    """A writer that keeps what is declared."""

    def __init__(self) -> None:
        self.connections: list[Connection] = []

    def add_connection(self, connection: Connection) -> int:
        self.connections.append(connection)
        return 100 + len(self.connections)


def publisher(topic: str = "/tf", text: str = "string data\n", **changes: Any) -> Connection:
    definition = Definition("ros2msg", text.encode()) if text else Definition()
    known: dict[str, Any] = {"id": 1, "msgtype": "a/msg/B", "serialization": "cdr", "definition": definition}
    return Connection(topic=topic, **(known | changes))


def declared(*connections: Connection, one_a_topic: bool = True) -> tuple[list[int], list[Connection]]:
    writer = Recorded()
    owners = [SimpleNamespace(handle=-1) for _ in connections]
    declare(writer, list(zip(connections, zip(owners), strict=True)), one_a_topic=one_a_topic)  # type: ignore[arg-type]
    return [owner.handle for owner in owners], writer.connections


@pytest.mark.parametrize(
    ("publishers", "handles", "digests"), rows(Path(__file__).with_name("publishers.txt"), "shared connections")
)
def test_publishers_share_a_connection_where_they_can(
    publishers: list[dict[str, Any]], handles: list[int], digests: list[str]
) -> None:
    found, written = declared(*(publisher(**each) for each in publishers))
    assert (found, [connection.digest for connection in written]) == (handles, digests)


def test_what_one_publisher_lacks_comes_from_another() -> None:
    others = (
        publisher(text=""),
        publisher("/other", id=8),
        publisher(digest="RIHS01_b", qos="- depth: 3", latching=True),
    )
    handles, found = declared(publisher(text="", id=7, qos="- depth: 1"), *others, publisher())
    assert handles == [101, 101, 102, 101, 101]
    assert [(connection.id, connection.topic) for connection in found] == [(7, "/tf"), (8, "/other")]
    assert found[0].definition.text == "string data\n"
    assert (found[0].digest, found[0].qos, found[0].latching) == ("RIHS01_b", "- depth: 1\n- depth: 3\n", True)


def test_alone_or_elsewhere_they_stay_as_they_are() -> None:
    connections = [publisher(id=7), publisher(id=9)]
    assert declared(*connections, one_a_topic=False) == ([101, 102], connections)
    connection = publisher(qos="[{depth: 1}]", metadata={"a": "b"})
    assert declared(connection) == ([101], [connection])
