"""The keywords of the public functions: misspelt ones, signatures, and the lists in docstrings."""

from __future__ import annotations

import inspect
import re
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from pc2scan.arguments import refuse_unknown

from .table import GROUPS, instead_of, options_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from .option import Option

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

#: Names that users of the command line, of ROS or of other tools may try, and the options that they mean.
SYNONYMS = {
    **dict.fromkeys(("threads", "workers", "nproc"), "jobs"),
    **dict.fromkeys(("z_min", "min_z", "zmin"), "min_height"),
    **dict.fromkeys(("z_max", "max_z", "zmax"), "max_height"),
    **dict.fromkeys(("min_range", "range"), "range_min range_max"),
    **dict.fromkeys(("begin", "from"), "start"),
    **dict.fromkeys(("duration", "until"), "end"),
    **dict.fromkeys(("config", "yaml", "launch"), "params_file"),
    **dict.fromkeys(("base_frame", "frame", "frame_id"), "target_frame"),
    **dict.fromkeys(("for", "consumer"), "consumers"),
    **dict.fromkeys(("output", "dst"), "destination"),
    "max_range": "range_max",
    "fov": "angle_min angle_max",
    "resolution": "angle_increment",
    "ros1": "to=bag",
    "ros2": "to=rosbag2",
    "format": "to",
    "force": "overwrite",
    "json": "report",
    "topic": "topics",
    "source": "sources",
    "channel": "channels",
    "tf_topic": "tf_topics",
    "static": "static_tf",
    "k": "pattern",
    "dir": "folder",
}

#: The modules in the names of types.
_MODULES = re.compile(r"\b[a-z_0-9.]+\.(?=[A-Z])|\bdatetime\.(?=datetime|timedelta)")

#: The width of the lists in docstrings.
_WIDTH = 112


def meant_by(command: str, word: str) -> list[str]:
    """Return the options of a command that are meant by a name, as errors write options."""
    known = options_of(command)
    return [f"`{meant}`" for meant in SYNONYMS.get(word, "").split() if meant.partition("=")[0] in known]


def takes_options(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorate a function that takes ``**options``, the options of the command with its name.

    A misspelt keyword raises a TypeError that suggests the right one, or says which function has it. The function's
    signature has the options; in its docstring, they stand at ``**options``.
    """
    name = function.__name__
    own = list(inspect.signature(function).parameters.values())[:-1]
    known = {key: option for key, option in options_of(name).items() if not option.command_only}
    named = {*known, *(parameter.name for parameter in own)}

    @wraps(function)
    def checked(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if not kwargs.keys() <= named:
            for key in kwargs.keys() - named:
                if hint := instead_of(name, key):
                    raise TypeError(f"{name}() has no argument {key!r}; {hint}")
            refuse_unknown(name, kwargs, named, {word: meant.split()[0] for word, meant in SYNONYMS.items()})
        return function(*args, **kwargs)

    ordered = sorted(known.values(), key=lambda option: not option.common)
    # A name that is only there for type checkers is text.
    types = {
        key: getattr(annotation.__origin__, "__forward_arg__", annotation.__origin__)
        for group in GROUPS[name]
        for key, annotation in group.__annotations__.items()
    }
    listed = [
        inspect.Parameter(
            option.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=option.default,
            annotation=types[option.name],
        )
        for option in ordered
    ]
    checked.__signature__ = inspect.signature(function).replace(parameters=[*own, *listed])  # type: ignore[attr-defined]
    entries = "".join(_describe(option, types[option.name]) for option in ordered)
    checked.__doc__ = (function.__doc__ or "").replace(_PLACE, entries)
    return checked


#: Where a docstring lists the options.
_PLACE = "    **options\n"


def _describe(option: Option, kind: Any) -> str:
    """Return an option's entry in a docstring, with the type of its values."""
    words = f"{option.help} {option.value.note}".split()
    if option.default_text:
        words += f"Default: {option.default_text}.".split()
    shown = kind if isinstance(kind, str) else inspect.formatannotation(kind)
    text, line = f"    {option.name} : {_MODULES.sub('', shown)}\n       ", 7
    for word in words:
        if line + len(word) >= _WIDTH:
            text, line = f"{text}\n       ", 7
        text, line = f"{text} {word}", line + len(word) + 1
    return text + "\n"
