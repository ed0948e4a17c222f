"""Several publishers of a topic, for a destination that has one connection a topic."""

from __future__ import annotations

import time
from typing import Any

from pc2scan.model import Connection, Definition
from pc2scan.pipeline.declarations import Declarations


class Recorded:
    """A writer that keeps what is declared."""

    def __init__(self) -> None:
        self.connections: list[Connection] = []

    def add_connection(self, connection: Connection) -> int:
        self.connections.append(connection)
        return 100 + len(self.connections)


def publisher(topic: str = "/tf", text: str = "string data\n", **changes: Any) -> Connection:
    known: dict[str, Any] = {
        "id": 1,
        "topic": topic,
        "msgtype": "a/msg/B",
        "serialization": "cdr",
        "definition": Definition("ros2msg", text.encode()) if text else Definition(),
    }
    return Connection(**(known | changes))


def declared(*connections: Connection, one_a_topic: bool = True) -> tuple[list[int], list[Connection]]:
    declarations, writer = Declarations(), Recorded()
    assert [declarations.add(connection) for connection in connections] == list(range(len(connections)))
    handles = declarations.declare(writer, one_a_topic=one_a_topic)  # type: ignore[arg-type]
    return handles, writer.connections


def test_publishers_of_a_topic_share_a_connection() -> None:
    handles, found = declared(
        publisher(id=7, qos="- depth: 1"), publisher("/other", id=8), publisher(id=9, qos="- depth: 2", latching=True)
    )
    assert handles == [101, 102, 101]
    assert [(connection.id, connection.topic) for connection in found] == [(7, "/tf"), (8, "/other")]
    assert found[0].qos == "- depth: 1\n- depth: 2\n"
    assert found[0].latching


def test_elsewhere_they_stay_apart() -> None:
    connections = [publisher(id=7), publisher(id=9)]
    assert declared(*connections, one_a_topic=False) == ([101, 102], connections)


def test_one_publisher_stays_as_it_is() -> None:
    connection = publisher(qos="[{depth: 1}]", metadata={"a": "b"})
    assert declared(connection) == ([101], [connection])


def test_types_and_serialisations_are_kept_apart() -> None:
    handles, _ = declared(
        publisher(),
        publisher(msgtype="a/B"),
        publisher(msgtype="a/msg/C"),
        publisher(serialization="json"),
        publisher(serialization="json", msgtype="a/B"),
    )
    assert handles == [101, 101, 102, 103, 104]


def test_names_that_become_one_in_utf8_are_one() -> None:
    handles, _ = declared(publisher("/a\udcff"), publisher("/a\udcfe"), publisher("/a\ufffd"))
    assert handles == [101, 101, 101]


def test_definitions_that_differ_are_kept_apart() -> None:
    handles, found = declared(
        publisher(text="string data\n"),
        publisher(text="# said aloud\nstring   data  # loudly\n\n"),
        publisher(text="int32 data\n"),
        publisher(text=""),
        publisher(text="int32 data\n", digest="RIHS01_b"),
        publisher(text="int32 data\n", digest="RIHS01_c"),
        publisher(text="uint8 comes_from_elsewhere", digest="RIHS01_b"),
    )
    assert handles == [101, 101, 102, 101, 102, 103, 102]
    assert [connection.digest for connection in found] == ["", "RIHS01_b", "RIHS01_c"]


def test_what_one_publisher_lacks_comes_from_another() -> None:
    handles, (connection,) = declared(publisher(text=""), publisher(), publisher(digest="RIHS01_b", qos="- depth: 3"))
    assert handles == [101, 101, 101]
    assert connection.definition.text == "string data\n"
    assert (connection.digest, connection.qos) == ("RIHS01_b", "- depth: 3")


def test_tens_of_thousands_of_publishers_take_no_time() -> None:
    large = Definition("ros2msg", b"string data  # and more\n" * 10_000)
    connections = [publisher(definition=large, qos="- depth: 1") for _ in range(20_000)]
    connections += [publisher(digest=f"RIHS01_{number}", text="") for number in range(20_000)]
    began = time.monotonic()
    handles, _ = declared(*connections)
    assert time.monotonic() - began < 5
    assert handles.count(101) == 20_000
