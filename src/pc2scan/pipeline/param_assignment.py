"""ROS's notation for one parameter, ``name:=value``."""

from __future__ import annotations

from pc2scan.errors import ParameterError

from .parameters import Setting
from .yaml_nodes import compose, scalar_value


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
