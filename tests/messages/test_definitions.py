"""The definitions that pc2scan writes are ROS's own, and identified as ROS identifies them."""

from __future__ import annotations

import pytest

from pc2scan.messages.definitions import TYPES, definition


@pytest.mark.parametrize("msgtype", sorted(TYPES))
@pytest.mark.parametrize("version", [1, 2])
def test_digests_are_those_of_the_text_according_to_rosbags(msgtype: str, version: int) -> None:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    written, digest = definition(msgtype, version)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(written.text, msgtype))
    assert written.encoding == f"ros{version}msg"
    if version == 1:
        assert store.generate_msgdef(msgtype, ros_version=1)[1] == digest
        return
    assert store.hash_rihs01(msgtype) == digest
    for distro in ("ROS2_HUMBLE", "ROS2_JAZZY", "ROS2_LYRICAL"):
        assert get_typestore(Stores[distro]).hash_rihs01(msgtype) == digest
