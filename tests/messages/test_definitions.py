"""The definitions that pc2scan writes are ROS's own, and identified as ROS identifies them."""

from __future__ import annotations

import json
import subprocess
from functools import cache
from pathlib import Path

import pytest

from pc2scan.messages.definitions import TYPES, definition
from pc2scan.model import ros1_type

SYSTEM_PYTHON = Path("/usr/bin/python3")


@cache
def debian_definitions() -> dict[str, tuple[str, str]]:
    """Return text and md5sum by type, from Debian's generated ROS 1 classes."""
    script = """
import importlib, json
out = {}
for msgtype in ("sensor_msgs/LaserScan", "sensor_msgs/PointCloud2", "tf2_msgs/TFMessage"):
    package, name = msgtype.split("/")
    message = getattr(importlib.import_module(package + ".msg"), name)
    out[msgtype] = message._full_text, message._md5sum
print(json.dumps(out))
"""
    if not SYSTEM_PYTHON.exists():
        pytest.skip("no /usr/bin/python3")
    done = subprocess.run([SYSTEM_PYTHON, "-c", script], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"Debian's ROS 1 message classes are not installed: {done.stderr.splitlines()[-1]}")
    found: dict[str, tuple[str, str]] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("msgtype", sorted(TYPES))
def test_ros1_text_and_md5sum_are_those_of_ros_itself(msgtype: str) -> None:
    written, digest = definition(msgtype, 1)
    assert (written.text, digest) == tuple(debian_definitions()[ros1_type(msgtype)])


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
