"""QoS profiles as rosbag2 records them: YAML in a string, ``offered_qos_profiles``."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

from .yaml import dump_yaml, load_yaml

__all__ = ["latches", "parsed_qos", "respelled_qos"]

_TRANSIENT_LOCAL = re.compile(r"""\bdurability["']?[ \t]*:[ \t]*["']?(?:1|transient_local)\b""", re.IGNORECASE)

# rmw/types.h: the place in the list is the value of the enumeration.
_NAMES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": (
        "system_default",
        "automatic",
        "manual_by_node",
        "manual_by_topic",
        "unknown",
        "best_available",
    ),
}


def latches(qos: str) -> bool:
    r"""Whether any of rosbag2's ``offered_qos_profiles`` has the durability transient local.

    Profiles with keys missing occur, and YAML parsers that insist on all keys fail on them; here only
    this key matters. Its value is rmw's number (1) or, from ROS 2 Jazzy on, its name.

    >>> latches("- history: 1\n  durability: 1"), latches("- durability: volatile")
    (True, False)
    """
    return _TRANSIENT_LOCAL.search(qos) is not None


def parsed_qos(text: str) -> list[dict[str, Any]] | None:
    """Profiles as mappings; None if the text is not a list of mappings."""
    with suppress(ValueError):
        loaded = load_yaml(text)
        if isinstance(loaded, list) and all(isinstance(profile, dict) for profile in loaded):
            return loaded
    return None


def respelled_qos(text: str, *, by_name: bool) -> str:
    r"""Spell the enumerations of QoS profiles as names (metadata version 9) or as numbers (before).

    Text that is spelled so already, or is not a list of profiles, is returned verbatim. Unknown or missing
    keys and values stay as they are.

    >>> respelled_qos("- depth: 10\n  durability: 1", by_name=True)
    '- depth: 10\n  durability: transient_local'
    """
    profiles = parsed_qos(text) if text else None
    if profiles is None:
        return text
    changed = [
        {key: _respelled(key, value, by_name=by_name) if key in _NAMES else value for key, value in profile.items()}
        for profile in profiles
    ]
    return text if changed == profiles else dump_yaml(changed).rstrip("\n")


def _respelled(key: str, value: Any, *, by_name: bool) -> Any:
    names = _NAMES[key]
    if by_name and isinstance(value, int) and not isinstance(value, bool):
        return names[value] if 0 <= value < len(names) else value
    if not by_name and isinstance(value, str) and value.lower() in names:
        return names.index(value.lower())
    return value
