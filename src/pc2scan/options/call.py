"""The options of one call, whoever gives them: Python, the command line or a file; and a call as a command line."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any

from .option import Parameter
from .processing import CloudCombination
from .table import PARAMETERS, conversion_options, options_of, spellings

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping

    from typing_extensions import Self

    from pc2scan.result import Call

#: The origin of parameters that are given as keywords in Python.
CALL = "the call"


class Options:
    """The options of one call. An attribute is an option's value: the one that was given, or the default.

    Parameters
    ----------
    command
        The command or function whose options these are.
    values
        What was given, by name; None means nothing.
    origins
        Where parameters of the projection come from, for errors and reports; missing ones were given in Python.

    Attributes
    ----------
    given
        What was given, by name, as `pc2scan.options.values` reads it. Values that are defaults are not in it, except
        those of the projection's parameters, which override those of files and presets.

    Raises
    ------
    TypeError, UsageError
        If a value has the wrong type, or means nothing.
    """

    __slots__ = ("_known", "command", "given", "origins")

    def __init__(
        self,
        command: str,
        values: Mapping[str, Any],
        origins: Mapping[str, str] | None = None,
    ) -> None:
        self.command = command
        self.origins = origins or {}
        self._known = options_of(command)
        self.given: dict[str, Any] = {}
        for name, value in values.items():
            option = self._known[name]
            if isinstance(option, Parameter):
                # NumPy's scalars as Python's.
                self.given[name] = value.item() if getattr(value, "ndim", None) == 0 else value
            elif value is not None:
                read, default = option.value.read(name, value), option.default
                is_default = read is default or (type(read) is type(default) and bool(read == default))
                if not is_default and read != ():
                    self.given[name] = read

    def __getattr__(self, name: str) -> Any:
        """Return the value of an option; one that this command does not have has the default of a conversion."""
        if name.startswith("_"):
            raise AttributeError(name)
        if name in self.given:
            return self.given[name]
        option = self._known.get(name) or options_of("convert").get(name)
        if option is None:
            raise AttributeError(f"{self.command} has no option {name!r}")
        return option.default

    def with_further(self, texts: Mapping[str, Iterable[str]]) -> Self:
        """Return the options with further values of options that may have several."""
        more = copy(self)
        more.given = self.given | {name: (*self.given.get(name, ()), *values) for name, values in texts.items()}
        return more

    def among(self, names: Container[str]) -> dict[str, Any]:
        """Return what was given of these options, in the order in which it was given."""
        return {name: value for name, value in self.given.items() if name in names}

    @property
    def of_conversions(self) -> dict[str, Any]:
        """What was given of the options that a batch gives to each conversion."""
        return self.among(conversion_options())

    @property
    def makes_scans(self) -> bool:
        """Whether parameters of the projection are given (by name, by a preset, in a file), or scans to be combined."""
        combining = CloudCombination.__annotations__.keys()
        return any(self.given.get(name) for name in ("params", "preset", "params_file", "param")) or any(
            name in PARAMETERS or name in combining for name in self.given
        )


def call_words(call: Call) -> list[str]:
    """Return the words of the command that a result proposes."""
    sources = (f"./{path}" if path.startswith("-") else path for path in call.sources)
    words = ["pc2scan", call.command, *sources]
    for name, value in call.options.items():
        words += _option_words(spellings().get(name, f"--{name}"), value)
    return words


def _option_words(spelling: str, value: Any) -> Iterator[str]:
    """Yield an option; negative numbers need no "=" before them, because no option begins with a digit."""
    if value is True:
        yield spelling
    elif isinstance(value, tuple):
        for item in value:
            yield from _option_words(spelling, item)
    else:
        yield from (spelling, f"{value:.15g}" if isinstance(value, float) else str(value))
