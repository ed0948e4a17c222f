from __future__ import annotations

from pc2scan.model import Connection, RawMessage, own, owned

TOPIC = Connection(1, "/a", "a/msg/A", "cdr")
OWN = b"some data"
BORROWED = memoryview(bytearray(OWN))


def test_what_is_borrowed_is_copied_to_be_kept() -> None:
    for data in (OWN, memoryview(OWN), memoryview(OWN)[2:5]):
        assert own(data) is data
    copy = own(BORROWED[2:5])
    assert isinstance(copy, bytes)
    assert copy == OWN[2:5]


def test_a_message_with_borrowed_data_is_copied_to_be_kept() -> None:
    message, borrowed = RawMessage(TOPIC, 1, OWN, 1), RawMessage(TOPIC, 2, BORROWED[:4], 2, 3)
    assert owned(message) is message
    copy = owned(borrowed)
    assert copy == borrowed
    assert isinstance(copy.data, bytes)
