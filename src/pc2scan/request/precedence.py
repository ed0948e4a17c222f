"""The parameters of the projection: their names in ROS, and the choice between several sources of one.

Every source (a call, ``--param name:=value``, a parameter file, a preset) is `Options`, which say where each value was
written. `resolve` takes each parameter from the source with the highest precedence, checks types and values, and builds
 `ProjectionParams`. An error names the parameter, the value and its origin.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from pc2scan.core.layout import FULL_TURN
from pc2scan.core.params import ProjectionParams, typed_value
from pc2scan.core.quantities import EXAMPLES
from pc2scan.errors import ParameterError
from pc2scan.options.call import CALL
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean, nearest

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pc2scan.options.call import Options
    from pc2scan.options.option import Parameter


#: ROS 1's names for parameters that ROS 2 renamed.
ALIASES = {"concurrency_level": "queue_size"}

#: Topics. Upstream's own ROS 1 sample lists them among the parameters; later ROS 2 versions declare the
#: last two.
TOPICS = frozenset({"cloud_in", "scan", "scan_in", "cloud", "point_cloud_topic", "scan_topic"})

#: Pairs of parameters that describe the same thing. The setting with the higher precedence is used, the other ignored.
_INSTEAD = {"beams": "angle_increment", "no_return": "use_inf"}
RIVALS = _INSTEAD | {rival: name for name, rival in _INSTEAD.items()}

# Scalars that are not quoted, in ROS.
_TRUE = frozenset(["y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])
_FALSE = frozenset(["n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])
_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_INTEGER = r"[-+]?([1-9][0-9]*|0[0-7]*|0[xX][0-9a-fA-F]+)"
_FLOAT = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
_SPECIAL = r"([-+]?)\.?(inf|Inf|INF|nan|NaN|NAN)"


#: Parameters that every ROS 2 node has.
_EVERY_NODE = frozenset({"use_sim_time", "start_type_description_service", "qos_overrides"})


def is_every_nodes(name: str) -> bool:
    """Whether a parameter is one that every ROS 2 node has; it does not change the projection."""
    return name.partition(".")[0] in _EVERY_NODE


def unknown_parameter(name: str, origin: str) -> ParameterError:
    """Return the error for an unknown parameter, with the known ones."""
    hint = f"the parameters are {', '.join(PARAMETERS)}"
    if name in TOPICS:
        hint = "topics are not parameters here; `topics` chooses them"
    message = f"unknown parameter {name!r} (from {origin})"
    if close := nearest(name, [*PARAMETERS, *ALIASES]):
        message += f"; did you mean {close!r}?"
    return ParameterError(message, name=name, hint=hint)


def _type_hint(parameter: Parameter, value: object) -> str | None:
    if isinstance(value, str) and parameter.value.unit and isinstance(plain_scalar(value), str):
        return EXAMPLES[parameter.value.unit]
    if parameter.value.words:
        return did_you_mean(str(value), parameter.value.words) or None
    if parameter.value.kind == "str" and isinstance(value, bool | int | float):
        return "YAML reads it as a number or a truth value; put it in quotes"
    if isinstance(value, str) and not isinstance(plain_scalar(value), str | bool | None):
        return "the quotes make it text; remove them"
    return None


def resolve(sources: Iterable[Options]) -> tuple[ProjectionParams, Mapping[str, str]]:
    """Take each parameter from the first source that has it, and check everything.

    Parameters
    ----------
    sources
        The highest precedence first: the call, ``param``, a file, a preset. What is overridden is checked, too.

    Returns
    -------
    params, origins
        A parameter that is not given has upstream's default. For each name, where its value comes from, or ``default``.

    Raises
    ------
    ParameterError
        If a value has the wrong type or is not allowed. The message names the parameter, the value and its origin; for
        contradicting values it names both origins.
    """
    values: dict[str, Any] = {}
    written: dict[str, object] = {}
    origins = dict.fromkeys(PARAMETERS, "default")
    for source in sources:
        chosen: dict[str, Any] = {}
        for name, text in source.among(PARAMETERS).items():
            parameter, origin, rival = PARAMETERS[name], source.origins.get(name, CALL), RIVALS.get(name, "")
            # A whole number is accepted where a float is expected; ROS 2 itself requires `30.0`. A number may have a
            # unit, or be arithmetic (`180deg`, `pi/2`, `50cm`).
            value = parameter.value.in_unit(text)
            try:
                value = typed_value(name, value)
            except ParameterError as err:
                message, hint = f"{err.message} (from {origin})", _type_hint(parameter, text)
                raise ParameterError(message, name=name, hint=hint) from err
            if not value and name in _INSTEAD:
                raise ParameterError(f"{name} is {value!r}, as if it were not given (from {origin})", name=name)
            if rival in chosen:
                message = f"{rival} and {name} set the same thing in two ways; give one of them"
                raise ParameterError(f"{message} ({rival} from {origins[rival]}; {name} from {origin})", name=rival)
            if name not in values and rival not in values:
                chosen[name], written[name], origins[name] = value, text, origin
        values |= chosen
    if values.keys() & {"angle_min", "angle_max"}:
        _refuse_degrees(values, origins, written)
    try:
        params = ProjectionParams(**values)
    except ParameterError as err:
        raise _with_origin(err, origins) from err
    if params.beams:
        origins["angle_increment"] = f"follows from {origins['beams']}"
    return params, origins


def _refuse_degrees(values: Mapping[str, Any], origin: Mapping[str, str], written: Mapping[str, object]) -> None:
    """Raise if the angles are too large for a sector: they are nearly always degrees.

    A sector may be a full turn with any limits, such as 1 to 1 + 2 pi. A sector of more than a turn is an error if the
    geometry would replace it by a full circle. The values are radians, and ``written`` what the user wrote for them.
    """
    names = ("angle_min", "angle_max")
    low, high = (values.get(name, PARAMETERS[name].default) for name in names)
    span = high - low
    if abs(span - 2 * math.pi) < FULL_TURN - 2 * math.pi or math.isinf(span):
        return
    beyond = [name for name, angle in zip(names, (low, high), strict=True) if abs(angle) > FULL_TURN]
    text = " and ".join(f"{name} is {values[name]} rad" for name in beyond)
    if not beyond and span > FULL_TURN and values.get("geometry") == "centered":
        beyond = [name for name in names if name in values]
        text = f"angle_min {low} to angle_max {high} rad is a sector of {span:g} rad"
    if not beyond:
        return
    hint = "a full circle is `angle_min=-180deg`, `angle_max=180deg`"
    if not all(re.search("deg|°", str(written.get(name))) for name in beyond):
        cures = ", ".join(f"`{name}={values[name]:g}deg`" for name in beyond)
        numbers = ", ".join(f"{math.radians(values[name]):.6g}" for name in beyond)
        hint = f"for degrees write {cures}, which is {numbers} rad"
    message = f"{text}, more than a full turn (2 pi is 6.28319 rad)"
    raise _with_origin(ParameterError(message, name=beyond[0], hint=hint), origin)


def preset_of(origin: str) -> str:
    """Return the name of the preset that a parameter's origin is; empty if it is another."""
    return origin.removeprefix("--preset ") if origin.startswith("--preset ") else ""


def is_given(origin: str) -> bool:
    """Return whether a parameter's origin is an option, ``--param`` or a call, not a file or a preset."""
    return origin == CALL or (origin.startswith("--") and not preset_of(origin))


def _with_origin(err: ParameterError, origin: Mapping[str, str]) -> ParameterError:
    """Return an error with the origins of the values that it names."""
    named = [name for name in PARAMETERS if re.search(rf"\b{name}\b", err.message)]
    places = [f"{name} {'is the' if origin[name] == 'default' else 'from'} {origin[name]}" for name in named]
    if named == [err.name]:
        places = [places[0].removeprefix(f"{err.name} ")]
    return ParameterError(f"{err.message} ({'; '.join(places)})", name=err.name, hint=err.hint)


def plain_scalar(text: str) -> bool | int | float | str | None:
    """Read an unquoted scalar as ROS 2 does.

    Source of the rule: ``get_value`` of rcl_yaml_param_parser/src/parse.c tries YAML 1.1's booleans, then
    ``strtol`` with base 0, then ``strtod``; the rest is text. So ``1e5`` is a number, unlike in YAML 1.1.
    """
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if text in _NULL:
        return None
    if re.fullmatch(_INTEGER, text):
        with suppress(ValueError):  # more digits than Python reads
            return int(text, 8 if re.match("[-+]?0[0-7]", text) else 0)
        return text
    if re.fullmatch(_FLOAT, text):
        return float(text)
    special = re.fullmatch(_SPECIAL, text)
    return float("".join(special.groups())) if special else text
