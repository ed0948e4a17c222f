"""Parameter files of ROS 2 that have all values of given parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.options.table import PARAMETERS
from pc2scan.pipeline.parameters import names_of

if TYPE_CHECKING:
    from pc2scan.core.params import ProjectionParams
    from pc2scan.pipeline.parameters import Direction


def render_params_file(params: ProjectionParams, *, direction: Direction = "pointcloud_to_laserscan") -> str:
    """Write a ROS 2 parameter file that reproduces a run, here or with upstream's node.

    Parameters
    ----------
    params
        Every value is written, except: a ``queue_size`` of 0, which is pc2scan's default (upstream's default is the
        number of processor cores); the defaults of parameters that upstream does not have; and of two parameters for
        the same thing the one that is not used (``beams`` became an increment, ``no_return`` overrides ``use_inf``).
    direction
        The node; only its parameters are written.

    Returns
    -------
    str
        YAML with the same meaning in YAML 1.1 and 1.2; floats keep every bit.
    """
    lines = [f"{direction}:", "  ros__parameters:"]
    for name in names_of(direction):
        value, parameter = getattr(params, name), PARAMETERS[name]
        left_out = (
            (name == "queue_size" and not value)
            or (not parameter.upstreams and value == parameter.default)
            or name == "beams"
            or (name == "use_inf" and params.no_return)
        )
        if not left_out:
            unit = parameter.unit
            lines.append(f"    {name}: {_rendered(value)}{f'  # {unit}' if unit else ''}")
    return "\n".join(lines) + "\n"


def _rendered(value: float | bool | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{"".join(map(_escaped, value))}"'
    text = repr(value)
    if "inf" in text:
        return text.replace("inf", ".inf")
    # Without a dot, YAML 1.1 reads 1e+300 as text.
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _escaped(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    return character if character.isprintable() else f"\\U{ord(character):08x}"
