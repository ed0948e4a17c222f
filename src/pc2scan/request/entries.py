"""Reads YAML as values with their places: parameter, scans and dataset files, or the same of Python's dicts and lists.

Scalars are read as ROS does. A file that another file names may be any file: errors about it are not quoted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.arguments import value_text
from pc2scan.core.quantities import written_angle
from pc2scan.errors import ParameterError, UsageError
from pc2scan.files.paths import is_url, local_path
from pc2scan.files.yaml import load_yaml
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean
from pc2scan.transforms.text_files import text_of

from .precedence import plain_scalar

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterable
    from os import PathLike

    from pc2scan.options.values import Value

#: Maximum size of a file. A larger one was given by mistake.
MAX_FILE_BYTES = 1_000_000

_YAML_TAG = "tag:yaml.org,2002:"

#: Tags that YAML gives to plain text; any other tag was written by the user.
_PLAIN_TAGS = frozenset(
    _YAML_TAG + kind for kind in ("str", "int", "float", "bool", "null", "timestamp", "merge", "value")
)


def compose(text: str, place: str) -> Any:
    """Parse YAML to the library's nodes; None for an empty document. Scalars are read by ROS's rules."""
    # ROS 2's parser accepts tabs between tokens, ruamel does not. Both reject tabs as indentation.
    spaced = re.sub(r"(?m)(?<=[^ \t\n])[ \t]*\t[ \t]*", lambda tabs: " " * len(tabs.group()), text)
    try:
        return load_yaml(spaced, nodes=True)
    except ValueError as err:
        hint = "indent with spaces, not with tabs" if r"'\t'" in str(err) else None
        raise ParameterError(f"{place}: {err}", hint=hint) from err


def scalar_value(node: Any, name: str, origin: str, *, ros1: bool = False) -> object:
    """Return the value of a scalar node of YAML; ``name`` and ``origin`` are for errors.

    Raises
    ------
    ParameterError
        If it has a tag that is not one of plain text.
    """
    if node.tag not in _PLAIN_TAGS:
        tag = node.tag.replace(_YAML_TAG, "!!")
        raise ParameterError(f"{name}: the YAML tag {tag} is not supported (from {origin})", name=name)
    if node.style:  # quoted, or a block of text
        return node.value
    angle = written_angle(node.value) if ros1 else None
    return plain_scalar(node.value) if angle is None else angle


def read_text(path: Path, example: str) -> str:
    """Return the text of a file; ``example`` is the hint if there is none."""
    try:
        return text_of(path, MAX_FILE_BYTES, "a file of options").removeprefix("\ufeff")
    except UsageError as err:
        # `naming_place` asks whether the cause is an OSError.
        raise ParameterError(f"{path}: {err.message}", hint=err.hint or example) from err.__cause__


class Entry(NamedTuple):
    """A value (a dict or a list of entries, or a scalar), its place, and the text of a scalar in a file; None: null."""

    value: Any
    place: str
    text: str | None = None

    def mapping(self, what: str, known: Collection[str], hint: str) -> dict[str, Entry]:
        """Return the entries by key; raise UsageError if it is no mapping, or a key is unknown."""
        entries = {} if self.value is None else self.value
        if not isinstance(entries, dict):
            raise UsageError(f"{self.place}: {what} must be a mapping, got {self.shown}", hint=hint)
        for key, entry in entries.items():
            if key not in known:
                raise UsageError(f"{entry.place}: unknown key {key!r}", hint=did_you_mean(key, known) or hint)
        return entries

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
        return value_text(self.value)


def entries_in(text: str, path: Path | str, example: str, scalar: Callable[..., object] = scalar_value) -> Entry:
    """Read the text of a YAML or JSON file.

    Parameters
    ----------
    text, path
        The text, and the file for errors.
    example
        The hint if it is empty.
    scalar
        Makes the value of a scalar node, by its name and its place.

    Raises
    ------
    ParameterError
        If it cannot be read.
    """
    root = compose(text, str(path))
    if root is None or not (root.value or getattr(root, "style", None)):
        raise ParameterError(f"{path}: the file is empty", hint=example)

    def entry(node: Any, name: str, line: int) -> Entry:
        place = f"{path}, line {line}"
        if node.id == "scalar":
            return Entry(scalar(node, name, place), place, str(node.value) if node.style or node.value else None)
        if node.id == "sequence":
            return Entry([entry(item, name, item.start_mark.line + 1) for item in node.value], place)
        entries: dict[str, Entry] = {}
        for key, value in node.value:
            at = key.start_mark.line + 1
            if key.id != "scalar":
                raise ParameterError(f"{path}, line {at}: a key must be plain text")
            text = str(key.value)
            if text == "<<":
                raise ParameterError(
                    f"{path}, line {at}: YAML's merge key (<<) is not supported", hint="write its values out"
                )
            if text in entries:
                raise ParameterError(f"{path}, line {at}: {text!r} is given twice, first in {entries[text].place}")
            entries[text] = entry(value, text, at)
        return Entry(entries, place)

    return entry(root, "", 1)


def entries_of(value: Any, place: str) -> Entry:
    """Return the entries of Python's dicts and lists."""
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{place} has the key {key!r}, it must be text")
        return Entry({key: entries_of(item, f"{place}[{key!r}]") for key, item in value.items()}, place)
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return Entry([entries_of(item, f"{place}[{n}]") for n, item in enumerate(value)], place)
    return Entry(value.item() if getattr(value, "ndim", None) == 0 else value, place)


@contextmanager
def naming_place(
    places: Mapping[str, str], default: str, files: Iterable[tuple[str | PathLike[str], str, str]] = ()
) -> Generator[None]:
    """Add the place of the key that an error names, unless the error has one; and quote nothing of files.

    Errors about the files are replaced by such with the line, but nothing of the content.

    Parameters
    ----------
    places, default
        The places of keys, and that of an error which names none of them.
    files
        The files, as errors show them; the place that names each; and the option with which the user can name it, and
        then errors may quote it.
    """
    try:
        yield
    except UsageError as err:
        text, own = f"{err.where}: {err.message}", err.name if isinstance(err, ParameterError) else ""
        for file, named_in, option in files:
            # If the file cannot be read, there is nothing to quote.
            if str(file) in text and not isinstance(err.__cause__, OSError):
                position = re.search(re.escape(str(file)) + r"(?:, |: |: .*? in )((?:line|entry) \d+)", text)
                # Any other name is content.
                name = own if own in PARAMETERS else ""
                what = f"{name}: expected another value" if name else "not valid"
                message = f"{file}{f', {position[1]}' if position else ''}: {what} (named in {named_in}"
                hint = f"`{option}={file}` shows what is wrong"
                raise ParameterError(f"{message}, so nothing of it is shown)", name=name, hint=hint) from None
        text = f"{err.message} {err.hint or ''}"
        named = (place for key, place in places.items() if key == own or f"`{key}`" in text or f"`{key}=" in text)
        if default and default.partition(",")[0] not in err.message:
            err.message += f" (from {next(named, default)})"
        raise
