"""Reads and writes QoS profiles as rosbag2 records them: YAML in a string, ``offered_qos_profiles``."""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pc2scan.files.yaml import dump_yaml, load_yaml

if TYPE_CHECKING:
    from collections.abc import Sequence

#: A profile takes some 400 characters, and a topic has one for each publisher. Reading more takes seconds.
MAX_CHARACTERS = 64_000

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


_INFINITE = {"sec": 9223372036, "nsec": 854775807}

#: rmw's defaults: keep last 10, reliable, volatile, automatic liveliness.
_DEFAULTS = {
    "history": 1,
    "depth": 10,
    "reliability": 1,
    "durability": 2,
    "deadline": _INFINITE,
    "lifespan": _INFINITE,
    "liveliness": 1,
    "liveliness_lease_duration": _INFINITE,
    "avoid_ros_namespace_conventions": False,
}


def parse_qos(text: str) -> list[dict[str, Any]] | None:
    """Return profiles as mappings; None if the text is not a list of mappings, or too long."""
    if len(text) > MAX_CHARACTERS:
        return None
    with suppress(ValueError):
        loaded = load_yaml(text)
        if isinstance(loaded, list) and all(isinstance(profile, dict) for profile in loaded):
            return loaded
    return None


def merge_qos(texts: Sequence[str]) -> str:
    r"""Put the profiles of several publishers of a topic into one list.

    rosbag2's recorder lists one profile for each publisher, equal ones too, and so does ``ros2 bag convert`` for the
    publishers of several recordings.

    Parameters
    ----------
    texts
        ``offered_qos_profiles`` of each; empty if not recorded. A text that is not a list of profiles is ignored, if
        another one is. If the lists are too long, equal texts are used once.

    >>> merge_qos(["- depth: 1", "", "[{depth: 2}]", "- depth: 1"])
    '- depth: 1\n- depth: 2\n- depth: 1\n'
    """
    known = [text for text in texts if text]
    distinct = dict.fromkeys(known)
    if len(known) < 2 or sum(map(len, distinct)) > MAX_CHARACTERS:
        return known[0] if known else ""
    lists = {text: profiles for text in distinct if (profiles := parse_qos(text))}
    if not lists:
        return known[0]
    written = {text: dump_yaml(profiles) for text, profiles in lists.items()}
    merged = "".join(written[text] for text in known if text in written)
    return merged if len(merged) <= MAX_CHARACTERS else "".join(written.values())


# Most topics of a recording have the same profile.
@lru_cache(maxsize=32)
def respell_qos(text: str) -> str:
    r"""Complete QoS profiles, and spell them as version 8 of a rosbag2 directory's metadata requires.

    rosbag2 and rosbags refuse a directory whose profiles lack a key; missing keys get rmw's defaults and infinite
    durations. Enumerations become numbers, as before version 9. Complete text in this spelling, and text that is not a
    list of profiles, is returned verbatim; so are unknown keys and values.

    >>> respell_qos("- depth: 10\n  durability: transient_local").splitlines()[:3]
    ['- depth: 10', '  durability: 1', '  history: 1']
    """
    profiles = parse_qos(text) if text else None
    if profiles is None:
        return text
    changed = [
        {
            key: _number(key, value) if key in _NAMES else value
            for key, value in (profile | {key: _DEFAULTS[key] for key in _DEFAULTS if key not in profile}).items()
        }
        for profile in profiles
    ]
    return text if changed == profiles else dump_yaml(changed).rstrip("\n")


def _number(key: str, value: Any) -> Any:
    names = _NAMES[key]
    return names.index(value.lower()) if isinstance(value, str) and value.lower() in names else value
