"""Parses YAML to nodes with their lines; scalars, also those of ``name:=value``, are read as ROS does."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from pc2scan.core.quantities import ANGLE, angle_value, written_angle
from pc2scan.errors import ParameterError

from .parameters import Setting, expected_message, is_every_nodes, plain_scalar

if TYPE_CHECKING:
    from collections.abc import Sequence

_YAML_TAG = "tag:yaml.org,2002:"

#: Tags that YAML gives to plain text; any other tag was written by the user.
_PLAIN_TAGS = frozenset(
    _YAML_TAG + kind for kind in ("str", "int", "float", "bool", "null", "timestamp", "merge", "value")
)

_ROS1_ANGLE_TAGS = {"!degrees": "deg", "!radians": "rad"}


def compose(text: str, place: str) -> Any:
    """Parse YAML to ruamel's nodes, which have their lines; None for an empty document.

    Nodes are used instead of values, so that aliases are not expanded, tags construct nothing, and scalars
    are read by ROS's rules.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415  # see `pc2scan.files.yaml`
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    # ROS 2's parser accepts tabs between tokens, ruamel does not. Both reject tabs as indentation.
    spaced = re.sub(r"(?m)(?<=[^ \t\n])[ \t]*\t[ \t]*", lambda tabs: " " * len(tabs.group()), text)
    yaml = YAML(typ="safe", pure=True)
    # An anchor that is defined twice is legal, so ruamel's warning is ignored.
    yaml.composer.warn_double_anchors = False
    try:
        return yaml.compose(spaced)
    except YAMLError as err:
        problem = getattr(err, "problem", None) or getattr(err, "reason", None) or "a syntax error"
        hint = "indent with spaces, not with tabs" if r"'\t'" in str(problem) else None
        message = f"{place}, {_yaml_position(err, spaced)}: not valid YAML: {problem}"
        raise ParameterError(message, hint=hint) from err
    except RecursionError as err:
        raise ParameterError(f"{place}: nested too deeply") from err


def _yaml_position(err: Exception, text: str) -> str:
    """Return `line 3, column 5` of a YAML error: most have a mark, unreadable characters have an index."""
    mark = getattr(err, "problem_mark", None)
    if mark is not None:
        return f"line {mark.line + 1}, column {mark.column + 1}"
    before = text[: getattr(err, "position", 0)]
    return f"line {before.count(chr(10)) + 1}, column {len(before) - before.rfind(chr(10))}"


def place_of(node: Any) -> str:
    """Return the place of a node as ``line 3, column 5``."""
    return f"line {node.start_mark.line + 1}, column {node.start_mark.column + 1}"


def is_mapping(node: Any) -> bool:
    """Whether a node is a mapping."""
    return bool(node.id == "mapping")


def is_scalar(node: Any) -> bool:
    """Whether a node is neither a mapping nor a list."""
    return bool(node.id == "scalar")


def is_empty(node: Any) -> bool:
    """Whether a node is an empty mapping or null."""
    return (is_mapping(node) and not node.value) or (is_scalar(node) and not node.style and not node.value)


def scalar_value(node: Any, name: str, origin: str, *, ros1: bool) -> object:
    """Return the value of a scalar node.

    Raises
    ------
    ParameterError
        If it is a list or a mapping, or has a tag that is not one of plain text.
    """
    if not is_scalar(node):
        found = "a mapping" if is_mapping(node) else "a list"
        raise ParameterError(expected_message(name, found, origin), name=name)
    if ros1 and node.tag in _ROS1_ANGLE_TAGS:
        unit = _ROS1_ANGLE_TAGS[node.tag]
        inner = ANGLE.fullmatch(node.value.strip())
        try:
            return angle_value(unit, inner[2] if inner else node.value)
        except ValueError as err:
            shown = f"{node.tag} {node.value}"
            raise ParameterError(expected_message(name, shown, origin), name=name) from err
    if node.tag not in _PLAIN_TAGS:
        tag = node.tag.replace(_YAML_TAG, "!!")
        raise ParameterError(f"{name}: the YAML tag {tag} is not supported (from {origin})", name=name)
    if node.style:  # quoted, or a block of text
        return node.value
    angle = written_angle(node.value) if ros1 else None
    return plain_scalar(node.value) if angle is None else angle


def parse_params(texts: Sequence[str]) -> list[Setting]:
    """Read parameters as `parse_param` does, the last one first, but for those that every node has."""
    found = [parse_param(text) for text in reversed(texts)]
    return [setting for setting in found if not is_every_nodes(setting.name)]


def parse_param(text: str) -> Setting:
    """Read ROS's notation for one parameter, ``name:=value``.

    Parameters
    ----------
    text
        ROS 2's form after ``--ros-args -p``, which may begin with a node's name (``node:name:=value``; the name is
        ignored), or ROS 1's form (``_name:=value``). The value is a YAML
        scalar: ``1``, ``1.0``, ``.inf``, ``true``, ``"text"``; also ROS 1's ``deg(90)`` and
        ``rad(pi/2)``. No text after ``:=`` means the empty text.

    Returns
    -------
    Setting
        Its value is not checked here; `resolve` does.

    Raises
    ------
    ParameterError
        If there is no ``:=`` or no name, or the value is not a YAML scalar.
    """
    rule, assigned, written = text.partition(":=")
    name = rule.rpartition(":")[2].strip().lstrip("_~")
    if not assigned:
        raise ParameterError(f"`param` {text!r} has no ':='", hint="write `param=range_min:=0.5`")
    if not name:
        raise ParameterError(f"`param` {text!r} has no name before ':='", hint="write `param=range_min:=0.5`")
    origin = f"--param {text}"
    if not written.strip():
        return Setting(name, "", origin, "param")
    try:
        node = compose(written, origin)
    except ParameterError as err:
        err.name = name
        raise
    value = None if node is None else scalar_value(node, name, origin, ros1=True)
    return Setting(name, value, origin, "param")
