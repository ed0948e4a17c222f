from __future__ import annotations

from pc2scan.bags.model import Connection, RawMessage, kept, worked_on

TOPIC = Connection(1, "/a", "a/msg/A", "cdr")
OWN = b"some data"
LENT = memoryview(bytearray(OWN))


def test_what_is_lent_is_copied_to_be_kept() -> None:
    for own in (OWN, memoryview(OWN), memoryview(OWN)[2:5]):
        assert kept(own) is own
    copy = kept(LENT[2:5])
    assert isinstance(copy, bytes)
    assert copy == OWN[2:5]


def test_what_work_leaves_of_a_message_is_kept() -> None:
    own, lent = RawMessage(TOPIC, 1, OWN, 1), RawMessage(TOPIC, 2, LENT[:4], 2, 3)
    first, second = worked_on([own, lent], None)
    assert first is own
    assert second == lent
    assert isinstance(second.data, bytes)
    done = worked_on([own, lent], lambda message: message._replace(data=message.data[1:], result="done"))
    assert [m.data for m in done] == [OWN[1:], OWN[1:4]]
    assert [m.result for m in done] == ["done"] * 2
    assert all(isinstance(m.data, bytes) for m in done)
    assert worked_on([], lambda message: message) == []
