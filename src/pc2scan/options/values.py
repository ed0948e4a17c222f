"""The types of options' values: one parser for each meaning, for Python, the command line and files alike."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import timedelta
from numbers import Integral, Real
from os import PathLike
from typing import TYPE_CHECKING

from pc2scan.arguments import names_in, value_and_type
from pc2scan.core.params import kth_of
from pc2scan.core.quantities import EXAMPLES, quantity
from pc2scan.errors import UsageError
from pc2scan.files.urls import path_of, paths_in
from pc2scan.text import did_you_mean

from .moment import TimeBound

if TYPE_CHECKING:
    from typing import Any

#: The longest time in seconds that a scan may be made of.
_LONGEST = 86_400.0


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


class Value:
    """The type of an option's values.

    Attributes
    ----------
    metavar
        What stands for a value in the command's help.
    kind
        The type of a parameter of the projection: ``float``, ``bool``, ``int`` or ``str``.
    usual
        What most values are, for errors.
    unit
        ``m``, ``rad``, ``s`` or empty.
    words
        The allowed texts; or the texts that a number may be instead. Empty: any text.
    is_text
        Whether a YAML scalar is read as it is written: ``010`` is the text 010.
    repeats
        Whether there may be several.
    note
        What Python takes besides, for the documentation.
    offers
        What the shell completes: ``frames``, ``words`` and the words, or ``topics`` and the ends of their
        types (none: all topics).
    """

    metavar: str | None = None
    kind = "str"
    usual = "text"
    unit = ""
    words: tuple[str, ...] = ()
    is_text = False
    repeats = False
    note = ""

    def __init__(self, metavar: str | None = None, words: Iterable[str] = (), *, offers: tuple[str, ...] = ()) -> None:
        if metavar is not None:
            self.metavar = metavar
        self.words = tuple(words)
        self.offers = offers or (("words", *self.words) if self.words else ())

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
        raise NotImplementedError

    def accept(self, value: object) -> Any:
        """Return a value of a parameter, from Python or a file, in its type; None if it has another one."""
        raise NotImplementedError

    def is_path(self, text: str) -> bool:  # noqa: ARG002
        """Return whether a value of a file is a path, which is relative to this file."""
        return False


class Flag(Value):
    """True or false."""

    kind = "bool"
    usual = "true or false"

    def read(self, name: str, value: Any) -> bool:
        """Return the value; text is refused, so that ``overwrite="no"`` replaces nothing."""
        if not isinstance(value, bool):
            raise TypeError(f"{name} is {value_and_type(value)}, it must be True or False")
        return value

    def accept(self, value: object) -> bool | None:
        """Return the value if it is true or false."""
        return value if isinstance(value, bool) else None


class Text(Value):
    """A text, or one of a few words."""

    is_text = True

    def read(self, name: str, value: Any) -> str:
        """Return the text."""
        if not isinstance(value, str):
            raise TypeError(f"{name} is {value_and_type(value)}, it must be a str, or None")
        if self.words and value and value not in self.words:
            raise UsageError(
                f"`{name}` is {value!r}, it must be one of {', '.join(self.words)}",
                hint=did_you_mean(value, self.words) or None,
            )
        return value

    def accept(self, value: object) -> str | None:
        """Return the text if it is allowed; YAML reads the words inf and nan as numbers."""
        text = str(value) if isinstance(value, float) and self.words else value
        return text if isinstance(text, str) and (text in self.words or not self.words) else None


class Reduction(Text):
    """How the returns of a beam become its range: a word, or ``kth=3``."""

    def accept(self, value: object) -> str | None:
        """Return the text if it is allowed."""
        return value if isinstance(value, str) and kth_of(value) else super().accept(value)


class Switch(Text):
    """True, or a text: an option whose value may be left out."""

    def read(self, name: str, value: Any) -> Any:
        """Return the text, or whether the option is on."""
        return value if isinstance(value, bool) else super().read(name, value)


class Texts(Value):
    """One text, or several."""

    usual = "text, or a list of texts"
    is_text = True
    repeats = True
    note = "One or several."

    def read(self, name: str, value: Any) -> Any:
        """Return the texts as a tuple."""
        texts = names_in(name, value)
        for text in texts:
            if self.words and text not in self.words:
                raise UsageError(
                    f"`{name}` has {text!r}, its values must be among {', '.join(self.words)}",
                    hint=did_you_mean(text, self.words) or None,
                )
        return texts


class TransformTexts(Texts):
    """Transforms as texts, and files with some; in Python also as `pc2scan.transforms.static.StaticTransform`."""

    def read(self, name: str, value: Any) -> Any:
        """Return texts, paths and objects as a tuple; `pc2scan.transforms.static.added_transforms` reads them."""
        several = isinstance(value, Iterable) and not isinstance(value, str | bytes)
        return tuple(self._read_one(name, each) for each in (value if several else (value,)))

    def _read_one(self, name: str, value: Any) -> Any:
        is_file = self.is_path(value) if isinstance(value, str) else isinstance(value, PathLike)
        return path_of(name, value) if is_file else value

    def is_path(self, text: str) -> bool:
        """Return whether it is the name of a YAML file."""
        return text.lower().endswith((".yaml", ".yml"))


class ChannelNames(Texts):
    """Fields of clouds; in Python also `pc2scan.UnprojectParams`."""

    def read(self, name: str, value: Any) -> Any:
        """Return the names as a tuple, or the object."""
        return value if type(value).__name__ == "UnprojectParams" else super().read(name, value)


class PathName(Value):
    """A path: `str` or `pathlib.Path`. In a file, it is relative to this file."""

    metavar = "FILE"
    usual = "a path"
    is_text = True

    def read(self, name: str, value: Any) -> Any:
        """Return the path."""
        return path_of(name, value)

    def is_path(self, text: str) -> bool:  # noqa: ARG002
        """Return that it is one."""
        return True


class Recordings(PathName):
    """The paths of one recording, or of several."""

    usual = "a path or a list of paths"
    repeats = True
    note = "One or several."

    def read(self, name: str, value: Any) -> Any:
        """Return the paths as a tuple."""
        return () if value in ((), []) else tuple(paths_in(name, value))


class Outputs(PathName):
    """A file with several outputs, or its content as mappings."""

    note = "Or the content of such a file: ``{'/scan': {'min_height': 0.1}, '/low': {'max_height': 0.1}}``."

    def read(self, name: str, value: Any) -> Any:
        """Return the path, or the content."""
        return path_of(name, value) if isinstance(value, str | PathLike) else value


class Count(Value):
    """A whole number from ``low`` to ``high``; for a parameter of the projection, also a word."""

    kind = "int"
    usual = "a whole number"

    def __init__(self, low: int = 0, high: int | None = None, *, metavar: str = "N", words: Iterable[str] = ()) -> None:
        super().__init__("|".join((metavar, *words)), words)
        self.low, self.high = low, high

    def read(self, name: str, value: Any) -> int:
        """Return the number."""
        if not isinstance(value, Integral) or isinstance(value, bool):
            raise TypeError(f"{name} is {value_and_type(value)}, it must be a whole number")
        number = int(value)
        if number < self.low or (self.high is not None and number > self.high):
            limits = f"{self.low} or more" if self.high is None else f"from {self.low} to {self.high:,}"
            raise UsageError(f"`{name}` is {number:,}, it must be {limits}")
        return number

    def accept(self, value: object) -> int | str | None:
        """Return the number, or one of the words."""
        if isinstance(value, str):
            return value if value in self.words else None
        # Where 0 is no value, it is the default of a parameter: none is given.
        if isinstance(value, int) and not isinstance(value, bool) and (value != 0 or self.low == 0):
            return value
        return None


class Number(Value):
    """A number, which may have a unit: ``50cm``, ``90deg``, ``100ms``, ``48us``."""

    kind = "float"
    usual = "a number"

    def __init__(self, unit: str = "", *, metavar: str | None = None, words: Iterable[str] = ()) -> None:
        super().__init__("|".join((unit.upper() if metavar is None else metavar, *words)), words)
        self.unit = unit

    def read(self, name: str, value: Any) -> float:
        """Return the number in metres, radians or seconds."""
        if isinstance(value, str):
            # What is typed is text, also if it is a plain number.
            with suppress(ValueError):
                return float(value)
        elif not _is_number(value):
            raise TypeError(f"{name} is {value_and_type(value)}, it must be a number")
        number = self.accept(value)
        if number is None:
            raise UsageError(f"`{name}`: {value!r} is not a number", hint=EXAMPLES.get(self.unit))
        return float(number)

    def accept(self, value: object) -> float | str | None:
        """Return the number in metres, radians or seconds, or one of the words; a plain number must not be text."""
        if isinstance(value, str):
            if value in self.words or not self.unit:
                return value if value in self.words else None
            with suppress(ValueError):
                float(value)
                return None
            return quantity(value, self.unit)
        # A whole number of 309 digits does not fit into a float.
        with suppress(OverflowError):
            return float(value) if _is_number(value) else None  # type: ignore[arg-type]
        return None


class Share(Number):
    """A share, 0 to 1, or in percent: ``0.05`` or ``5%``."""

    def read(self, name: str, value: Any) -> float:
        """Return the share."""
        if not isinstance(value, str):
            return super().read(name, value)
        try:
            return float(value.removesuffix("%")) / (100 if value.endswith("%") else 1)
        except ValueError as err:
            raise UsageError(f"`{name}`: {value!r} is not a share", hint="write 0.05 or 5%") from err


class Duration(Value):
    """A time: seconds, text such as ``500ms``, or a `datetime.timedelta`. `nanoseconds_of` reads it."""

    usual = "a number of seconds, or text such as 500ms"
    note = "Also a timedelta."

    def read(self, name: str, value: Any) -> Any:  # noqa: ARG002
        """Return the value as it is: `pc2scan.request.options.Combining` reads it."""
        return value


def nanoseconds_of(name: str, value: Any, more: str = "") -> int:
    """Read a time in the forms of `Duration`; ``more`` is added to the hint of the error."""
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


class Moment(Value):
    """A time in a recording; see `pc2scan.options.moment.TimeBound`."""

    usual = "a number or a text"
    note = "Also a datetime with a time zone, a numpy.datetime64 (UTC), or a timedelta from the beginning."

    def read(self, name: str, value: Any) -> Any:
        """Return it as a `pc2scan.options.moment.TimeBound`."""
        try:
            return TimeBound.of(value)
        except UsageError as err:
            err.message = f"`{name}`: {err.message}"
            raise


class Moments(Moment):
    """One time in a recording, or several."""

    repeats = True

    def read(self, name: str, value: Any) -> Any:
        """Return them as a tuple of `pc2scan.options.moment.TimeBound`."""
        # A NumPy array without dimensions is one time; a `TimeBound` is a tuple.
        several = isinstance(value, Iterable) and not isinstance(value, str) and not hasattr(value, "absolute")
        if several and getattr(value, "shape", True) != ():
            return tuple(super(Moments, self).read(name, time) for time in value)
        return (super().read(name, value),)


class Tolerances(Value):
    """A number for all values, or numbers by name: ``0.001``, ``x=0.001``, ``{"x": 0.001}``."""

    repeats = True
    note = "A number, or a dict of numbers by name."

    def read(self, name: str, value: Any) -> Mapping[str, float]:
        """Return the numbers by name; the empty name is for all others."""
        if isinstance(value, list | tuple):
            return self._typed(name, value)
        tolerances = value if isinstance(value, Mapping) else {"": value}
        if not all(map(_is_number, tolerances.values())):
            raise TypeError(f"{name} is {value!r}, it must be a number, or a dict of numbers")
        return tolerances

    def _typed(self, name: str, texts: Iterable[str]) -> dict[str, float]:
        """Read tolerances as they are typed."""
        tolerances: dict[str, float] = {}
        for text in texts:
            field, _, number = text.rpartition("=")
            try:
                tolerance = float(number)
            except ValueError:
                raise UsageError(
                    f"`{name}`: {text!r} is not a tolerance", hint=f"write `{name}=0.001` or `{name}=intensities=0.5`"
                ) from None
            if field in tolerances:
                raise UsageError(f"`{name}` is given twice for {field or 'all values'}")
            tolerances[field] = tolerance
        return tolerances


class Instance(Value):
    """An object of Python, which only functions take."""

    def read(self, name: str, value: Any) -> Any:  # noqa: ARG002
        """Return the object."""
        return value


class Filters(Instance):
    """A filter of points, or several: see `pc2scan.request.filters.Filter`."""

    def read(self, name: str, value: Any) -> tuple[Any, ...]:
        """Return the filters as a tuple."""
        filters = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else (value,)
        for item in filters:
            if isinstance(item, type) or not hasattr(item, "explanation"):
                text = "; a condition as text is the argument `where`" if isinstance(item, str) else ""
                raise TypeError(
                    f"{name} has {value_and_type(item)}, it must be a filter, such as pc2scan.Where('ring < 8'){text}"
                )
        return filters


class Function(Instance):
    """A function of Python."""

    def read(self, name: str, value: Any) -> Any:
        """Return the function."""
        if not callable(value):
            raise TypeError(f"{name} is {value_and_type(value)}, it must be a function, or None")
        return value


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
