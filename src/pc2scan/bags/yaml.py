"""YAML as rosbag2 writes it; the library is loaded by the first call."""

from __future__ import annotations

import io
from typing import Any

__all__ = ["dump_yaml", "load_yaml"]


def load_yaml(text: str) -> Any:
    """Read a document.

    Raises
    ------
    ValueError
        If it is not YAML; the text says what it is, and where it is wrong.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415  (only rosbag2 and its QoS profiles need it)
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    try:
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, RecursionError) as err:
        mark = getattr(err, "problem_mark", None)
        place = f" in line {mark.line + 1}" if mark is not None else ""
        raise ValueError(f"is not valid YAML{place}: {getattr(err, 'problem', None) or err}") from err


def dump_yaml(value: Any) -> str:
    """Write in block style, keys in the order given, strings on one line."""
    from ruamel.yaml import YAML  # noqa: PLC0415  (only rosbag2 and its QoS profiles need it)

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # declared as None
    yaml.allow_unicode = True
    yaml.width = 1 << 20
    stream = io.StringIO()
    yaml.dump(value, stream)
    return stream.getvalue()
