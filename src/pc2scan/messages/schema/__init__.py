"""Message definitions as data: read from text, checked, compared, written, hashed.

A `Schema` spells types as ROS 2 does, whatever the source, and has only what both ROS versions share:
``std_msgs/msg/Header`` has no sequence number, ROS 1's ``time`` and ``duration`` are those of ``builtin_interfaces``.
`render` and `md5sum` write ROS 1's spelling again.

Definitions come from untrusted recordings: `parse` and `closure` accept plain identifiers only and bound sizes, depth
and recursion, so that all later steps are bounded too.

Sources: http://wiki.ros.org/msg, https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html,
https://mcap.dev/spec/registry (how ``ros1msg``, ``ros2msg`` and ``ros2idl`` concatenate definitions),
genmsg's ``gentools.py`` (the md5sum), REP 2016 (RIHS01).
"""

from __future__ import annotations

from .checking import closure, min_size, same_layout
from .definition_text import parse
from .message_sets import fielddefs, known_types
from .rendering import md5sum, render, rihs01
from .types import HEADER, PRIMITIVES, Constant, Field, Schema, Struct, canonical_type, is_builtin

__all__ = [
    "HEADER",
    "PRIMITIVES",
    "Constant",
    "Field",
    "Schema",
    "Struct",
    "canonical_type",
    "closure",
    "fielddefs",
    "is_builtin",
    "known_types",
    "md5sum",
    "min_size",
    "parse",
    "render",
    "rihs01",
    "same_layout",
]
