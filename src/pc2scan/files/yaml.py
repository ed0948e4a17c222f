"""Reads and writes YAML as rosbag2 writes it; the first call loads the library."""

from __future__ import annotations

import io
import re
from functools import lru_cache
from typing import Any

#: rosbag2 writes some 600 characters a topic. The library takes up to 300 bytes and 20 microseconds for each character.
MAX_CHARACTERS = 800_000

#: The library's time is quadratic in the number of open brackets.
_MAX_BRACKETS = 100


@lru_cache(maxsize=16)
def load_yaml(text: str, *, nodes: bool = False) -> Any:
    """Read a document, which may not be changed: it is kept, because most topics have equal QoS profiles.

    Tags construct no objects, and aliases may not make a document larger than its text. With ``nodes``, the library's
    nodes are returned, which have their lines.

    Raises
    ------
    ValueError
        If it is not YAML, has more than 800,000 characters, or its aliases expand to more; the text says where.
    """
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"has more than {MAX_CHARACTERS:,} characters, which is more than rosbag2 writes")
    from ruamel.yaml import YAML  # noqa: PLC0415  # a third of a start, where nothing is YAML
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    depth = deepest = 0
    for bracket in re.findall(r"[\[\]{}]", text):
        depth = depth + 1 if bracket in "[{" else max(depth - 1, 0)
        deepest = max(deepest, depth)
    if deepest > _MAX_BRACKETS:
        raise ValueError(f"is not valid YAML: it is nested more than {_MAX_BRACKETS} levels deep")
    document, size = None, 0
    try:
        yaml = YAML(typ="safe", pure=True)
        # A repeated anchor is legal.
        yaml.composer.warn_double_anchors = False
        node = yaml.compose(text)
        size = 0 if node is None else _unfolded_size(node, {})
        # The two characters of `a:` are three nodes.
        if 0 < size <= len(text) + 1:
            document = node if nodes else yaml.constructor.construct_document(node)
    except (YAMLError, RecursionError, ValueError, ArithmeticError, LookupError, TypeError, AttributeError) as err:
        # Besides its own, the library raises errors for, say, a mapping as a key, or a tag on a value of another type.
        mark = getattr(err, "problem_mark", None)
        place = f" in line {mark.line + 1}" if mark is not None else ""
        # Without Python's advice about long integers.
        reason = getattr(err, "problem", None) or getattr(err, "reason", None) or str(err).partition(";")[0]
        raise ValueError(f"is not valid YAML{place}: {reason}") from err
    if size > len(text) + 1:
        raise ValueError("is not valid YAML: its aliases multiply to more values than it has characters")
    return document


def _unfolded_size(node: Any, sizes: dict[int, int]) -> int:
    """Return the number of nodes with every alias expanded."""
    if node.id == "scalar":
        return 1
    if id(node) not in sizes:
        # An alias inside its own anchor expands without end.
        sizes[id(node)] = 1 << 64
        parts = (part for pair in node.value for part in pair) if node.id == "mapping" else iter(node.value)
        sizes[id(node)] = 1 + sum(_unfolded_size(part, sizes) for part in parts)
    return sizes[id(node)]


def dump_yaml(value: Any) -> str:
    """Write in block style, keys in the order given, strings on one line."""
    from ruamel.yaml import YAML  # noqa: PLC0415

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # declared as None
    yaml.allow_unicode = True
    yaml.width = 1 << 20
    stream = io.StringIO()
    yaml.dump(value, stream)
    return stream.getvalue()
