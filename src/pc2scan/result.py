"""Results: data with one description, from which text, JSON and the command's output are made.

A result is a data class. ``body`` and ``remarks`` describe it; ``print``, notebooks and the command show these parts.
`as_dict` has its attributes.
"""

from __future__ import annotations

import json
import math
from abc import abstractmethod
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from .errors import Pc2ScanError, visible
from .text import Table, stamp
from .version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from .bags.damage import Damage

#: How many damaged places, and reasons for skipping, are shown; JSON has all.
SHOWN = 5

#: How many skipped messages are listed one by one; all of them are counted.
MAX_LISTED = 100

#: The beginning of every result as JSON: such a file may be replaced by another one.
BEGINNING = b'{\n  "pc2scan": "'


class Remark(NamedTuple):
    """A line beside the result, such as ``warning: ...``; commands print it on standard error."""

    label: str
    text: str

    def __str__(self) -> str:
        return f"{self.label}: {self.text}"


class Call(NamedTuple):
    """A call of pc2scan that a result proposes; shown as Python, or as a command line.

    Attributes
    ----------
    command
        The command, and the function.
    sources
        The recordings.
    options
        Its options, by their names in Python.
    reasons
        Why options are there, by their names.
    """

    command: str
    sources: Sequence[str]
    options: Mapping[str, Any]
    reasons: Mapping[str, str] = {}

    def __str__(self) -> str:
        sources = list(self.sources)
        words = [repr(sources[0] if len(sources) == 1 else sources)]
        words += [f"{name}={value!r}" for name, value in self.options.items()]
        return f"pc2scan.{self.command}({', '.join(words)})"


#: A part of a result: a line of text (an empty line separates parts), a table, a call, or a remark.
Part: TypeAlias = str | Table | Call | Remark


class Skipped(NamedTuple):
    """A message that was skipped, or several with one reason.

    Attributes
    ----------
    topic, log_time_ns, stamp_ns
        The message; a time is None if it is unknown.
    reason
        The reason, with numbers.
    hint
        What the user can do; empty if unknown.
    targets
        The topics of the destination that miss its result.
    messages
        How many messages were skipped for this reason, this one included.
    gap_ns
        How far the nearest transform is away, nanoseconds; 0 if that is not the reason.
    """

    topic: str
    log_time_ns: int | None
    stamp_ns: int | None
    reason: str
    hint: str = ""
    targets: tuple[str, ...] = ()
    messages: int = 1
    gap_ns: int = 0

    def __str__(self) -> str:
        place = self.topic
        if self.stamp_ns is not None:
            place += f", stamp {stamp(self.stamp_ns)}"
        elif self.log_time_ns is not None:
            place += f", log time {stamp(self.log_time_ns)}"
        return f"{place}: {self.reason}"


class Result:
    """A result of a command.

    Attributes
    ----------
    kind
        Its name in JSON.
    json_names
        The attributes that JSON has after the common ones; empty means all fields but those with ``repr=False``.
    errors
        Why it failed; empty if it did not.
    warnings
        Problems that did not stop it.
    notes
        Values that were measured, or chosen by default.
    damage
        Damaged places in the parts of the recordings that were read.
    skipped
        The first messages that were skipped.
    """

    __slots__ = ()

    kind: ClassVar[str]
    json_names: ClassVar[tuple[str, ...]] = ()

    errors: Sequence[Pc2ScanError] = ()
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    damage: Sequence[Damage] = ()
    skipped: Sequence[Skipped] = ()

    @property
    def skipped_count(self) -> int:
        """How many messages were skipped, listed or not."""
        return sum(entry.messages for entry in self.skipped)

    @property
    def exit_status(self) -> int:
        """The exit status of the command; 3 if messages were skipped or a recording is damaged, else 0."""
        return 3 if self.damage or self.skipped_count else 0

    @abstractmethod
    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the result, part by part; ``verbose`` for everything."""

    def remarks(self, *, verbose: bool = False, total: int | None = None) -> Iterator[Remark]:
        """Yield what is not as it should be: skipped messages, damaged places, warnings.

        Parameters
        ----------
        verbose
            Whether to yield every reason and every damaged place.
        total
            How many messages were skipped, listed or not; None for all.
        """
        limit = None if verbose else SHOWN
        reasons: dict[tuple[str, str], list[Skipped]] = {}
        for entry in self.skipped:
            reasons.setdefault((entry.topic, entry.reason), []).append(entry)
        groups = list(reasons.values())[:limit]
        for entries in groups:
            number = sum(entry.messages for entry in entries)
            yield Remark("skipped", str(entries[0]) + (f" ({number:,} messages)" if number > 1 else ""))
        # A message counts once for each output that lacks it, like in the counts of the topics.
        shown = sum(entry.messages * max(1, len(entry.targets)) for entries in groups for entry in entries)
        if (more := (self.skipped_count if total is None else total) - shown) > 0:
            yield Remark("skipped", f"{more:,} more")
        # The hint for the one that is farthest from any transform helps the others, too.
        if hinted := [entry for entry in self.skipped if entry.hint]:
            yield Remark("hint", max(hinted, key=lambda entry: entry.gap_ns).hint)
        yield from (Remark("damaged", str(place)) for place in self.damage[:limit])
        if more := len(self.damage) - len(self.damage[:limit]):
            yield Remark("damaged", f"{more:,} more")
        yield from (Remark("warning", warning) for warning in self.warnings)

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON's types; infinities and NaNs are text."""
        common = ("exit_status", "errors", "warnings", "notes", "damage", "skipped_count")
        names = [name for name in _names(self) if name not in common]
        values = {name: json_value(getattr(self, name)) for name in (*common, *names)}
        return {"pc2scan": __version__, "kind": self.kind, **values}

    def as_json(self) -> str:
        """Return it as the text of a JSON file."""
        return json.dumps(self.as_dict(), indent=2) + "\n"

    def __repr__(self) -> str:
        notes = (Remark("note", note) for note in self.notes)
        return "\n".join(map(visible, lines_of((*self.body(), *notes, *self.remarks()))))


def lines_of(
    parts: Iterable[Part], width: int | None = None, spelled: Callable[[str | Call | Remark], str] = str
) -> Iterator[str]:
    """Yield parts of a result as lines.

    Parameters
    ----------
    width
        The columns that tables are fitted to; None for no limit.
    spelled
        Returns the text of a call, a remark, or a text with names of options. Default: as in Python.
    """
    for part in parts:
        if isinstance(part, Table):
            yield from part._replace(rows=[[*map(spelled, row)] for row in part.rows]).lines(width)
        else:
            # Calls stand in a line of their own.
            yield f"  {spelled(part)}" if isinstance(part, Call) else spelled(part)


def json_value(value: Any, text: Callable[[str], str] = str) -> Any:
    """Return a value as JSON's types: infinities and NaNs are text, objects are dictionaries of their attributes.

    ``text`` is called with all texts and keys.

    >>> json_value({"range_max": float("inf"), "angles": (0.5, float("nan"))})
    {'range_max': 'inf', 'angles': [0.5, 'nan']}
    """
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, str):
        return text(value)
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, dict):
        return {text(key): json_value(part, text) for key, part in value.items()}
    if isinstance(value, Path):
        # Not os.fspath: that of a URL has its secrets.
        return str(value)
    if hasattr(value, "as_dict"):
        return json_value(value.as_dict(), text)
    if is_dataclass(value) or hasattr(value, "_fields"):
        return {name: json_value(getattr(value, name), text) for name in _names(value)}
    return [json_value(part, text) for part in value]


def _names(value: Any) -> tuple[str, ...]:
    """Return the names that an object has in JSON: those that its class lists, or its fields."""
    if listed_names := getattr(value, "json_names", ()):
        return tuple(listed_names)
    return tuple(value._fields if hasattr(value, "_fields") else (part.name for part in fields(value) if part.repr))


def tell_early(warnings: list[str], warn: Callable[[str], None] | None, *texts: str) -> None:
    """Add warnings to a result's, and pass them on at once, because a user may stop the run, or the run may fail.

    ``warn`` is called with each of them that is new; None: nobody waits for them.
    """
    for text in texts:
        if text not in warnings:
            warnings.append(text)
            if warn is not None:
                warn(text)
