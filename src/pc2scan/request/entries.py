"""Reads scans files and dataset files, or the same of Python's dicts and lists: values with their places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import ParameterError, UsageError
from pc2scan.files.urls import is_url, local_path
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean

from .parameters import value_text
from .params_file import read_text
from .yaml_nodes import compose, is_empty, is_mapping, is_scalar, scalar_value

if TYPE_CHECKING:
    from collections.abc import Collection, Generator

    from pc2scan.options.values import Value

#: Maximum number of levels of nesting.
_MAX_DEPTH = 20


class Entry(NamedTuple):
    """A value of a file (a dict or a list of entries, or a scalar), its place, and the text of a scalar in a file."""

    value: Any
    place: str
    text: str | None = None

    def mapping(self, what: str, known: Collection[str], hint: str) -> dict[str, Entry]:
        """Return the entries by key; raise UsageError if it is no mapping, or a key is unknown."""
        found = {} if self.value is None else self.value
        if not isinstance(found, dict):
            raise UsageError(f"{self.place}: {what} must be a mapping, got {self.shown}", hint=hint)
        for key, entry in found.items():
            if key not in known:
                raise UsageError(f"{entry.place}: unknown key {key!r}", hint=did_you_mean(key, known) or hint)
        return found

    def read(self, key: str, kind: Value, folder: Path) -> Any:
        """Return the value of an option, in which paths are relative to a folder.

        Raises
        ------
        UsageError
            If it has not the type of the option's values.
        """
        entries = self.value if isinstance(self.value, list) and kind.repeats else [self]
        values = [entry.text if kind.is_text and entry.text is not None else entry.value for entry in entries]
        try:
            if not values or any(value is None or isinstance(value, dict | list) for value in values):
                raise TypeError
            # Those of the projection are checked where all their sources are compared.
            if key not in PARAMETERS:
                kind.read(key, values if kind.repeats else values[0])
        except (TypeError, UsageError) as err:
            message = f"{self.place}: {key} must be {kind.expected}, got {self.shown}"
            raise UsageError(message, hint=err.hint if isinstance(err, UsageError) else None) from err
        for number, value in enumerate(values):
            if isinstance(value, str) and kind.is_path(value) and not is_url(value := local_path(value)):
                values[number] = str(folder / Path(value).expanduser())
        return tuple(values) if kind.repeats else values[0]

    @property
    def shown(self) -> str:
        """What it is, for errors."""
        return "a mapping" if isinstance(self.value, dict) else value_text(self.value)


def entries_in(path: Path, example: str) -> Entry:
    """Read a YAML or JSON file.

    Raises
    ------
    UsageError
        If it cannot be read; ``example`` is the hint if it is missing or empty.
    """
    text = read_text(path, example)
    root = compose(text, str(path))
    if root is None or is_empty(root):
        raise UsageError(f"{path}: the file is empty", hint=example)
    left = len(text)

    def entry(node: Any, name: str, depth: int, line: int) -> Entry:
        nonlocal left
        place = f"{path}, line {line}"
        left -= 1
        if left < 0:
            raise UsageError(f"{path}: its aliases multiply to more values than the file has characters")
        if depth > _MAX_DEPTH:
            raise UsageError(f"{place}: nested more than {_MAX_DEPTH} levels deep")
        if is_scalar(node):
            text = None if is_empty(node) else str(node.value)
            return Entry(scalar_value(node, name, place, ros1=False), place, text)
        if not is_mapping(node):
            return Entry([entry(each, name, depth + 1, each.start_mark.line + 1) for each in node.value], place)
        found: dict[str, Entry] = {}
        for key, value in node.value:
            at = key.start_mark.line + 1
            if not is_scalar(key):
                raise UsageError(f"{path}, line {at}: a key must be plain text")
            text = str(key.value)
            if text in found:
                raise UsageError(f"{path}, line {at}: {text!r} is given twice, first in {found[text].place}")
            found[text] = entry(value, text, depth + 1, at)
        return Entry(found, place)

    return entry(root, "", 0, 1)


def entries_of(value: Any, place: str, depth: int = 0) -> Entry:
    """Return the entries of Python's dicts and lists."""
    if depth > _MAX_DEPTH:
        raise UsageError(f"{place}: nested more than {_MAX_DEPTH} levels deep")
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{place} has the key {key!r}, it must be text")
        return Entry({key: entries_of(each, f"{place}[{key!r}]", depth + 1) for key, each in value.items()}, place)
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return Entry([entries_of(each, f"{place}[{n}]", depth + 1) for n, each in enumerate(value)], place)
    return Entry(value.item() if getattr(value, "ndim", None) == 0 else value, place)


@contextmanager
def naming_place(places: Mapping[str, str], default: str) -> Generator[None]:
    """Add the place of the key that an error names, unless the error has one; ``default`` if it names none."""
    try:
        yield
    except UsageError as err:
        said = f"{err.message} {err.hint or ''}"
        own = err.name if isinstance(err, ParameterError) else ""
        named = (place for key, place in places.items() if key == own or f"`{key}`" in said or f"`{key}=" in said)
        if default and default.partition(",")[0] not in err.message:
            err.message += f" (from {next(named, default)})"
        raise
