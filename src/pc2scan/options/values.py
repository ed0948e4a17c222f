"""The types of options' values: one reader for each meaning, for Python, the command line and files alike."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import partial
from numbers import Integral, Real
from os import PathLike
from typing import Any, TypeAlias

from pc2scan.arguments import names_in, value_and_type
from pc2scan.core.quantities import EXAMPLES, quantity
from pc2scan.errors import UsageError
from pc2scan.files.paths import path_of, paths_in
from pc2scan.text import did_you_mean
from pc2scan.transforms.static import number_in

from .moment import TimeBound

#: The longest time in seconds that a scan may be made of.
_LONGEST = 86_400.0

#: Reads a value of a type, given the option's name for errors, from Python or as it was typed.
_Reader: TypeAlias = "Callable[[Value, str, Any], Any]"


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


@dataclass(frozen=True, slots=True)
class Value:
    """The type of an option's values.

    Attributes
    ----------
    reader
        See `read`.
    metavar
        What stands for a value in the command's help.
    usual
        What most values are, for errors.
    kind
        ``float``, ``bool``, ``int`` or ``str``; ``switch``: true, or a text; ``object``: only functions take it.
    words
        The allowed texts; or the texts that a number may be instead. Empty: any text.
    offers
        What the shell completes, if not the words: ``frames``, or ``topics`` and the ends of their types (none: all
        topics).
    unit
        ``m``, ``rad``, ``s`` or empty.
    low, high
        The limits of a whole number.
    is_text
        Whether a YAML scalar is read as it is written: ``010`` is the text 010.
    repeats
        Whether there may be several.
    paths
        Ends of texts that are paths, which are relative to the file that they are written in.
    note
        What Python takes besides, for the documentation.
    """

    reader: _Reader
    metavar: str | None = None
    usual: str = "text"
    kind: str = "str"
    words: tuple[str, ...] = ()
    offers: tuple[str, ...] = ()
    unit: str = ""
    low: int = 0
    high: int | None = None
    is_text: bool = False
    repeats: bool = False
    paths: tuple[str, ...] = ()
    note: str = ""

    @property
    def expected(self) -> str:
        """What must be given, for errors."""
        if self.words and self.kind == "str":
            return f"one of {', '.join(self.words)}"
        return " or ".join((self.usual, *self.words))

    def read(self, name: str, value: Any) -> Any:
        """Read a value from Python or as it was typed; errors name the option.

        Raises
        ------
        TypeError
            If it has the wrong type.
        UsageError
            If it means nothing.
        """
        return self.reader(self, name, value)

    def is_path(self, text: str) -> bool:
        """Return whether a value of a file is a path, which is relative to this file."""
        return text.lower().endswith(self.paths)

    def in_unit(self, value: Any) -> Any:
        """Return the number or the word that a value of a parameter stands for: ``50cm``; others as they are."""
        # A plain number must not be text: the node does not take it.
        if isinstance(value, str) and self.unit and number_in(value, "") is None:
            number = quantity(value, self.unit)
            return value if number is None else number
        # YAML reads the words inf and nan as numbers.
        return str(value) if isinstance(value, float) and str(value) in self.words else value


def _read_text(kind: Value, name: str, value: Any) -> Any:
    if not isinstance(value, str):
        raise TypeError(f"{name} is {value_and_type(value)}, it must be a str, or None")
    if kind.words and value and value not in kind.words:
        raise UsageError(
            f"`{name}` is {value!r}, it must be one of {', '.join(kind.words)}",
            hint=did_you_mean(value, kind.words) or None,
        )
    return value


#: The type of a text, or of one of a few words.
text = partial(Value, _read_text, is_text=True)


def _read_texts(kind: Value, name: str, value: Any) -> tuple[str, ...]:
    read = names_in(name, value)
    for word in read:
        if kind.words and word not in kind.words:
            raise UsageError(
                f"`{name}` has {word!r}, its values must be among {', '.join(kind.words)}",
                hint=did_you_mean(word, kind.words) or None,
            )
    return read


#: The type of one text, or several.
texts = partial(
    Value, _read_texts, usual="text, or a list of texts", is_text=True, repeats=True, note="One or several."
)


def _read_number(kind: Value, name: str, value: Any) -> float:
    """Return the number in metres, radians or seconds."""
    if not isinstance(value, str) and not _is_number(value):
        raise TypeError(f"{name} is {value_and_type(value)}, it must be a number")
    # What is typed is text, also if it is a plain number.
    read = number_in(value, kind.unit) if isinstance(value, str) else float(value)
    if read is None:
        raise UsageError(f"`{name}`: {value!r} is not a number", hint=EXAMPLES.get(kind.unit))
    return read


#: The type of a number, which may have a unit: ``50cm``, ``90deg``, ``100ms``, ``48us``.
number = partial(Value, _read_number, usual="a number", kind="float")


def _read_count(kind: Value, name: str, value: Any) -> int:
    if isinstance(value, str):
        try:
            value = int(value)
        except ValueError:
            raise UsageError(f"`{name}` is {value!r}, it must be a whole number") from None
    if not isinstance(value, Integral) or isinstance(value, bool):
        raise TypeError(f"{name} is {value_and_type(value)}, it must be a whole number")
    read = int(value)
    if read < kind.low or (kind.high is not None and read > kind.high):
        limits = f"{kind.low} or more" if kind.high is None else f"from {kind.low} to {kind.high:,}"
        raise UsageError(f"`{name}` is {read:,}, it must be {limits}")
    return read


#: The type of a whole number; for a parameter of the projection, also a word.
count = partial(Value, _read_count, metavar="N", usual="a whole number", kind="int")


def _read_path(_: Value, name: str, value: Any) -> Any:
    return path_of(name, value)


#: The type of a path: `str` or `pathlib.Path`.
path = partial(Value, _read_path, usual="a path", is_text=True, paths=("",))


def _read_flag(_: Value, name: str, value: Any) -> bool:
    """Return the value; text is refused, so that ``overwrite="no"`` replaces nothing."""
    if not isinstance(value, bool):
        raise TypeError(f"{name} is {value_and_type(value)}, it must be True or False")
    return value


def _read_switch(kind: Value, name: str, value: Any) -> Any:
    return value if isinstance(value, bool) else _read_text(kind, name, value)


def _read_transforms(kind: Value, name: str, value: Any) -> tuple[Any, ...]:
    """Return texts, paths and objects; `pc2scan.transforms.static.added_transforms` reads them."""
    several = isinstance(value, Iterable) and not isinstance(value, str | bytes)
    return tuple(
        path_of(name, item) if isinstance(item, PathLike) or (isinstance(item, str) and kind.is_path(item)) else item
        for item in (value if several else (value,))
    )


def _read_channels(kind: Value, name: str, value: Any) -> Any:
    return value if type(value).__name__ == "UnprojectParams" else _read_texts(kind, name, value)


def _read_recordings(_: Value, name: str, value: Any) -> tuple[Any, ...]:
    return () if value in ((), []) else tuple(paths_in(name, value))


def _read_outputs(_: Value, name: str, value: Any) -> Any:
    return path_of(name, value) if isinstance(value, str | PathLike) else value


def _read_share(kind: Value, name: str, value: Any) -> float:
    is_percent = isinstance(value, str) and value.endswith("%")
    share = _read_number(kind, name, value[:-1] if is_percent else value) / (100 if is_percent else 1)
    if not 0 <= share <= 1:
        raise UsageError(f"`{name}` is {share:g}, it must be a share from 0 to 1", hint="write 0.05 or 5%")
    return share


def nanoseconds_of(name: str, value: Any, more: str = "") -> int:
    """Read a `duration`; ``more`` is added to the hint of the error."""
    seconds: float | None
    if isinstance(value, str):
        seconds = quantity(value, "s")
    elif isinstance(value, timedelta):
        seconds = value.total_seconds()
    else:
        seconds = float(value) if _is_number(value) else None
    if seconds is None:
        raise UsageError(f"`{name}` is {value!r}, which is not a time", hint=EXAMPLES["s"] + more)
    if not (math.isfinite(seconds) and 1e-9 <= seconds <= _LONGEST):
        raise UsageError(f"`{name}` is {value!r}, it must be more than 0 and at most {_LONGEST:g} s")
    return round(seconds * 1e9)


def _read_moment(_: Value, name: str, value: Any) -> TimeBound:
    try:
        return TimeBound.of(value)
    except UsageError as err:
        err.message = f"`{name}`: {err.message}"
        raise


def _read_moments(kind: Value, name: str, value: Any) -> tuple[TimeBound, ...]:
    # A NumPy array without dimensions is one time; a `TimeBound` is a tuple.
    several = isinstance(value, Iterable) and not isinstance(value, str) and not hasattr(value, "absolute")
    is_one = not several or getattr(value, "shape", True) == ()
    return tuple(_read_moment(kind, name, item) for item in ((value,) if is_one else value))


def _read_tolerances(_: Value, name: str, value: Any) -> Mapping[str, float]:
    """Return the numbers by name; the empty name is for all others."""
    if isinstance(value, list | tuple):
        return _typed_tolerances(name, value)
    tolerances = value if isinstance(value, Mapping) else {"": value}
    if not all(map(_is_number, tolerances.values())):
        raise TypeError(f"{name} is {value!r}, it must be a number, or a dict of numbers")
    return tolerances


def _typed_tolerances(name: str, words: Iterable[str]) -> dict[str, float]:
    tolerances: dict[str, float] = {}
    for word in words:
        field, _, digits = word.rpartition("=")
        try:
            tolerance = float(digits)
        except ValueError:
            raise UsageError(
                f"`{name}`: {word!r} is not a tolerance", hint=f"write `{name}=0.001` or `{name}=intensities=0.5`"
            ) from None
        if field in tolerances:
            raise UsageError(f"`{name}` is given twice for {field or 'all values'}")
        tolerances[field] = tolerance
    return tolerances


def _read_filters(_: Value, name: str, value: Any) -> tuple[Any, ...]:
    filters = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else (value,)
    for item in filters:
        if isinstance(item, type) or not hasattr(item, "explanation"):
            more = "; a condition as text is the argument `where`" if isinstance(item, str) else ""
            raise TypeError(
                f"{name} has {value_and_type(item)}, it must be a filter, such as pc2scan.Where('ring < 8'){more}"
            )
    return filters


def _read_function(_: Value, name: str, value: Any) -> Any:
    if not callable(value):
        raise TypeError(f"{name} is {value_and_type(value)}, it must be a function, or None")
    return value


def _as_it_is(_: Value, __: str, value: Any) -> Any:
    return value


#: The type of a time: seconds, text such as ``500ms``, or a `datetime.timedelta`; see `nanoseconds_of`.
duration = partial(Value, _as_it_is, usual="a number of seconds, or text such as 500ms", note="Also a timedelta.")
FLAG = Value(_read_flag, usual="true or false", kind="bool")
#: True, or a text: an option whose value may be left out.
SWITCH = Value(_read_switch, "[ADDRESS]", kind="switch", is_text=True)
#: Transforms as texts, and files with some; in Python also as `pc2scan.transforms.static.StaticTransform`.
TRANSFORMS = replace(texts("TRANSFORM"), reader=_read_transforms, paths=(".yaml", ".yml"))
#: Fields of clouds; in Python also `pc2scan.UnprojectParams`.
CHANNELS = replace(texts("NAME", words=("distances", "stamps", "viewpoint")), reader=_read_channels)
#: The paths of one recording, or of several.
RECORDINGS = replace(
    path("FILE"), reader=_read_recordings, usual="a path or a list of paths", repeats=True, note="One or several."
)
#: A file with several outputs, or its content as mappings.
OUTPUTS = replace(
    path("FILE"),
    reader=_read_outputs,
    note="Or the content of such a file: ``{'/scan': {'min_height': 0.1}, '/low': {'max_height': 0.1}}``.",
)
#: 0 to 1, or in percent: ``0.05`` or ``5%``.
SHARE = replace(number("SHARE"), reader=_read_share)
#: A time in a recording; see `pc2scan.options.moment.TimeBound`.
MOMENT = Value(
    _read_moment,
    "TIME",
    "a number or a text",
    note="Also a datetime with a time zone, a numpy.datetime64 (UTC), or a timedelta from the beginning.",
)
MOMENTS = replace(MOMENT, reader=_read_moments, repeats=True)
#: A number for all values, or numbers by name: ``0.001``, ``x=0.001``, ``{"x": 0.001}``.
TOLERANCES = Value(_read_tolerances, "[NAME=]X", repeats=True, note="A number, or a dict of numbers by name.")
#: Objects of Python, which only functions take.
OBJECT = Value(_as_it_is, kind="object")
FILTERS = Value(_read_filters, kind="object")
FUNCTION = Value(_read_function, kind="object")


def in_words(value: float | bool | str) -> str:
    """Return a parameter's value for users: ``no limit`` and ``above 0`` for the largest and the smallest number.

    >>> in_words(1.7976931348623157e308), in_words(2.2250738585072014e-308), in_words(True), in_words(-0.3)
    ('no limit', 'above 0', 'true', '-0.3')
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and value in (sys.float_info.max, math.inf):
        return "no limit"
    return "above 0" if value == sys.float_info.min else str(value)
