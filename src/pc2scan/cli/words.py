"""Options that were typed, as the words of the library."""

from __future__ import annotations

from enum import Enum
from typing import Any, get_args, get_origin

from .groups import Group
from .options import ParameterOptions, length, share

__all__ = ["typed_words"]

#: Options whose words differ from their names in the groups.
_NAMES = {"tf_topic": "tf_topics"}


def typed_words(*groups: Group) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the options that have another value than their default, by word, and what was typed for parameters.

    They are words of `pc2scan.batch.request.request_of`.
    """
    words: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for group in groups:
        if isinstance(group, ParameterOptions):
            words |= {setting.name: setting.value for setting in group.settings}
            origins |= {setting.name: setting.origin for setting in group.settings}
            continue
        for name, kind in type(group).__annotations__.items():
            value = getattr(group, name)
            if isinstance(value, Group):
                inner, from_inner = typed_words(value)
                words |= inner
                origins |= from_inner
            elif value not in _defaults(group, name, kind):
                words[_NAMES.get(name, name)] = _plain(name, value)
    if words.pop("no_verify", False):
        words["verify"] = False
    words.pop("ros_args", None)
    return words, origins


def _defaults(group: Group, name: str, kind: object) -> tuple[Any, ...]:
    is_list = get_origin(get_args(kind)[0]) is list
    return ([], ()) if is_list else (getattr(type(group), name, None),)


def _plain(name: str, value: Any) -> Any:
    if name == "range_cutoff":
        return length("--range-cutoff", value)
    if name == "min_used":
        return share(value)
    if isinstance(value, list):
        return tuple(each.value if isinstance(each, Enum) else each for each in value)
    return value
