"""Ask tf2 itself: a script for the Python that Debian's python3-tf2-ros is installed for.

Reads a list of questions from standard input, as JSON::

    {"transforms": [[parent, child, stamp_ns, tx, ty, tz, qx, qy, qz, qw, static], ...],
     "lookups": [[target, source, stamp_ns], ...]}

and writes for each a list with one answer a lookup: seven numbers (translation, quaternion), or tf2's name for the
error and its text. Standard library and ROS only.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from genpy import Duration, Time
from geometry_msgs.msg import TransformStamped
from tf2_py import BufferCore, TransformException

SECOND = 1_000_000_000


def _message(parent: str, child: str, stamp_ns: int, pose: list[float]) -> TransformStamped:
    message = TransformStamped()
    message.header.frame_id = parent
    message.header.stamp = Time(*divmod(stamp_ns, SECOND))
    message.child_frame_id = child
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = pose[:3]
    rotation.x, rotation.y, rotation.z, rotation.w = pose[3:]
    return message


def _answer(buffer: BufferCore, target: str, source: str, stamp_ns: int) -> list[float] | list[str]:
    try:
        found = buffer.lookup_transform_core(target, source, Time(*divmod(stamp_ns, SECOND))).transform
    except TransformException as err:
        return [type(err).__name__, str(err)]
    t, q = found.translation, found.rotation
    return [t.x, t.y, t.z, q.x, q.y, q.z, q.w]


def _answers(question: dict[str, list[list[Any]]]) -> list[list[float] | list[str]]:
    # As long as it can be without overflowing the seconds of a stamp of today.
    buffer = BufferCore(Duration(2_000_000_000))
    for parent, child, stamp_ns, *pose, static in question["transforms"]:
        message = _message(parent, child, stamp_ns, pose)
        (buffer.set_transform_static if static else buffer.set_transform)(message, "oracle")
    return [_answer(buffer, *lookup) for lookup in question["lookups"]]


if __name__ == "__main__":
    json.dump([_answers(question) for question in json.load(sys.stdin)], sys.stdout)
