"""The options of each recording: those of the call override those of a dataset file. All are checked beforehand.

A dataset file is YAML that gives options to the recordings of a dataset, by patterns.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.errors import ParameterError, UsageError
from pc2scan.files.places import missing_hint
from pc2scan.files.source import open_bytes
from pc2scan.files.urls import is_url, local_path
from pc2scan.options.table import dataset_options
from pc2scan.options.values import Flag, Texts
from pc2scan.request.parameters import RIVALS, plain_scalar
from pc2scan.request.redaction import may_quote, redact_file
from pc2scan.request.yaml_nodes import compose, is_empty, is_mapping, is_scalar
from pc2scan.requests import NAMED_FILES
from pc2scan.text import did_you_mean

from .jobs import Request, request_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from pc2scan.options.values import Value

#: Larger files are refused.
_MAX_BYTES = 1_000_000

_SECTIONS = ("defaults", "recordings")


@dataclass(frozen=True)
class DatasetEntry:
    """Options for the recordings that a pattern matches.

    Attributes
    ----------
    line
        The line where it begins in the file.
    patterns
        Globs; empty for the defaults, which match everything.
    keywords
        Options by name, as `pc2scan.datasets.jobs.request_of` reads them.
    origins
        Where each option comes from.
    skip
        Whether the recordings are skipped; None if the entry does not have it.
    """

    line: int
    patterns: tuple[str, ...] = ()
    keywords: Mapping[str, Any] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)
    skip: bool | None = None

    @cached_property
    def _expressions(self) -> list[re.Pattern[str]]:
        return [re.compile(_expression(pattern)) for pattern in self.patterns]

    def matches(self, key: str) -> bool:
        """Return whether the entry applies to the recording with this key."""
        return not self.patterns or any(expression.fullmatch(key) for expression in self._expressions)


@dataclass(frozen=True)
class DatasetFile:
    """The content of a dataset file: its entries, the defaults first."""

    path: Path | None = None
    entries: tuple[DatasetEntry, ...] = ()


def load_dataset_file(path: Path) -> DatasetFile:
    """Read a dataset file.

    Raises
    ------
    UsageError
        If it cannot be read, is not YAML, or does not match the schema; the message names the line.
    """
    try:
        with open_bytes(path) as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as err:
        hint = missing_hint(path, (".yaml", ".yml")) if isinstance(err, FileNotFoundError) else None
        raise UsageError(f"the dataset file cannot be read: {err.strerror}", path=path, hint=hint) from err
    if len(data) > _MAX_BYTES:
        raise UsageError(f"has more than {_MAX_BYTES:,} bytes: too many for a dataset file", path=path)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as err:
        raise UsageError(f"is not UTF-8: {err.reason}", path=path) from err
    try:
        root = compose(text, str(path))
    except ParameterError as err:
        raise UsageError(err.message, hint=err.hint) from err
    return _FileReader(path).read(root)


class _FileReader:
    """Reads the nodes of a dataset file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        #: The line of the key whose value is read. Errors name it, because YAML places an empty value at the next key.
        self._key_line = 1

    def read(self, root: Any) -> DatasetFile:
        if root is None or is_empty(root):
            raise UsageError("is empty", path=self._path, hint="it has `defaults:`, `recordings:`, or both")
        entries: list[DatasetEntry] = []
        sections = dict(self._pairs(root, "the file", _SECTIONS))
        if (defaults := sections.get("defaults")) is not None and not is_empty(defaults):
            entries.append(self._entry(defaults, "defaults"))
        if (recordings := sections.get("recordings")) is not None and not is_empty(recordings):
            if recordings.id != "sequence":
                raise self._error(recordings, "recordings is not a list", "write '- match: PATTERN' for each entry")
            entries += [self._entry(node, "an entry of recordings") for node in recordings.value]
        return DatasetFile(self._path, tuple(entries))

    def _entry(self, node: Any, where: str) -> DatasetEntry:
        is_default = where == "defaults"
        options = dataset_options()
        known = (*(() if is_default else ("match", "skip")), *options)
        keywords: dict[str, Any] = {}
        origins: dict[str, str] = {}
        patterns: tuple[str, ...] = ()
        skip = None
        for name, value in self._pairs(node, where, known):
            if name == "match":
                patterns = self._value(value, name, Texts())
            elif name == "skip":
                skip = self._value(value, name, Flag())
            else:
                keywords[name] = self._value(value, name, options[name].value)
                origins[name] = f"{self._path}, line {_line(value)}"
        if not patterns and not is_default:
            raise self._error(node, "an entry of recordings has no match", "write 'match: robot1/**' in it")
        return DatasetEntry(_line(node), patterns, keywords, origins, skip)

    def _pairs(self, node: Any, where: str, known: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """Yield the names and values of a mapping; raises if a name is unknown or occurs twice."""
        if not is_mapping(node):
            raise self._error(node, f"{where} is not a mapping of names to values")
        seen: dict[str, int] = {}
        for key, value in node.value:
            name = str(key.value) if is_scalar(key) else "?"
            if name not in known:
                near = did_you_mean(name, known)
                few = f"allowed: {', '.join(known)}" if len(known) < 5 else None
                raise self._error(key, f"{name!r} is not allowed in {where}", near or few)
            if name in seen:
                raise self._error(key, f"{name} is given twice; first in line {seen[name]}")
            seen[name] = self._key_line = _line(key)
            yield name, value

    def _value(self, node: Any, name: str, kind: Value) -> Any:
        """Return the value of an option, in the form of a keyword."""
        if kind.repeats:
            nodes = node.value if node.id == "sequence" else [node]
            if not nodes or not all(is_scalar(each) and not is_empty(each) for each in nodes):
                raise self._unexpected(node, name, kind)
            return tuple(self._scalar(each, name, kind) for each in nodes)
        if not is_scalar(node) or is_empty(node):
            raise self._unexpected(node, name, kind)
        return self._scalar(node, name, kind)

    def _scalar(self, node: Any, name: str, kind: Value) -> Any:
        value = str(node.value) if kind.is_text or node.style else plain_scalar(node.value)
        if isinstance(value, float) and not math.isfinite(value) and not kind.unit:
            raise self._unexpected(node, name, kind)
        if not kind.admits(value):
            raise self._unexpected(node, name, kind)
        return self._located(value) if isinstance(value, str) and kind.is_path(value) else value

    def _located(self, text: str) -> str:
        """Resolve a path that is relative to the dataset file."""
        text = local_path(text)
        return text if is_url(text) else str(self._path.parent / Path(text).expanduser())

    def _unexpected(self, node: Any, name: str, kind: Value) -> UsageError:
        found = {"mapping": "a mapping", "sequence": "a list"}.get(node.id) or repr(str(node.value)[:80])
        near = did_you_mean(str(node.value), kind.words) if is_scalar(node) and kind.words else ""
        return self._error(node, f"{name} is {found}, it must be {kind.expected}", near or None)

    def _error(self, node: Any, message: str, hint: str | None = None) -> UsageError:
        line = self._key_line if is_empty(node) else _line(node)
        return UsageError(f"line {line}: {message}", path=self._path, hint=hint)


def _line(node: Any) -> int:
    return int(node.start_mark.line) + 1


def _expression(pattern: str) -> str:
    """Translate a glob: ``*`` matches within one name, ``**`` any number of folders; a folder matches its content."""
    pattern = pattern.removeprefix("./").removesuffix("/")
    parts = []
    position = 0
    for found in re.finditer(r"\*\*/|\*\*|\*|\?|\[[^\]/]+\]", pattern):
        parts.append(re.escape(pattern[position : found.start()]))
        match token := found[0]:
            case "**/":
                parts.append("(?:.*/)?")
            case "**":
                parts.append(".*")
            case "*":
                parts.append("[^/]*")
            case "?":
                parts.append("[^/]")
            case _:
                parts.append("[" + token[1:-1].replace("\\", "\\\\").replace("!", "^", token[1] == "!") + "]")
        position = found.end()
    parts.append(re.escape(pattern[position:]))
    anywhere = "" if "/" in pattern else "(?:.*/)?"
    return f"{anywhere}{''.join(parts)}(?:/.*)?"


# --- The options of each recording ---


class Choices:
    """Finds the options of recordings. Recordings with the same options share one request.

    Parameters
    ----------
    dataset
        The dataset file.
    keywords
        Options of the call. They override those of the file.
    origins
        Where each option of the call comes from, for errors.

    Raises
    ------
    UsageError
        If the options of the call alone, or with the defaults of the file, are wrong.
    """

    def __init__(self, dataset: DatasetFile, keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        self._dataset = dataset
        self._call = DatasetEntry(0, keywords=keywords, origins=origins)
        self._made: dict[tuple[int, ...], Request | None] = {}
        self._request(tuple(number for number, entry in enumerate(dataset.entries) if not entry.patterns))

    def of(self, keys: Iterable[str]) -> dict[str, Request | None]:
        """Return the options of recordings, by key; None for those that are skipped.

        Raises
        ------
        UsageError
            If options are wrong; the message names the line of the dataset file.
        """
        entries = list(enumerate(self._dataset.entries))
        return {key: self._request(tuple(number for number, entry in entries if entry.matches(key))) for key in keys}

    def warnings(self, keys: Iterable[str]) -> list[str]:
        """Return warnings about the dataset file and the options."""
        listed = list(keys)
        unused = [
            f"{self._dataset.path}, line {entry.line}: matches no recording: {', '.join(entry.patterns)}"
            for entry in self._dataset.entries
            if not any(map(entry.matches, listed))
        ]
        notes = [note for request in self._made.values() if request for note in request.notes]
        return [*unused, *dict.fromkeys(notes)]

    def _request(self, numbers: tuple[int, ...]) -> Request | None:
        """Return the options of a recording that these entries of the file apply to."""
        if numbers not in self._made:
            keywords: dict[str, Any] = {}
            origins: dict[str, str] = {}
            skip = False
            for entry in (*(self._dataset.entries[number] for number in numbers), self._call):
                for name in entry.keywords:
                    # Another option that means the same is overridden, too.
                    keywords.pop(RIVALS.get(name, ""), None)
                    origins.pop(name, None)
                keywords |= entry.keywords
                origins |= entry.origins
                skip = skip if entry.skip is None else entry.skip
            try:
                self._made[numbers] = None if skip else request_of(keywords, origins)
            except UsageError as err:
                self._refuse_to_quote(err, keywords, origins)
                if numbers and not any(origin in err.message for origin in origins.values()):
                    self._add_origin(err, self._dataset.entries[numbers[-1]], keywords, origins)
                raise
        return self._made[numbers]

    def _refuse_to_quote(self, err: UsageError, keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        """Raise another error if one is about a file that the dataset file names, and may quote it."""
        for name in NAMED_FILES:
            if name in keywords and name not in self._call.keywords:
                value = keywords[name]
                for path in value if isinstance(value, tuple) else (value,):
                    if may_quote(err, path):
                        raise redact_file(err, path, origins[name], name) from None

    def _add_origin(
        self, err: UsageError, last: DatasetEntry, keywords: Mapping[str, Any], origins: Mapping[str, str]
    ) -> None:
        """Add the line of the dataset file that has the wrong option to the message; if unknown, that of ``last``."""
        text = f"{err.message} {err.hint or ''}"
        named = [name for name in origins if f"`{name}`" in text or f"`{name}=" in text]
        if isinstance(err, ParameterError) and err.name in origins:
            named.insert(0, err.name)
        # Some messages quote the wrong value (a transform, a topic) instead of the option.
        named += [
            name
            for name, value in keywords.items()
            if name not in self._call.keywords
            and any(repr(text) in err.message for text in (value if isinstance(value, tuple) else (value,)))
        ]
        where = next((origins[name] for name in named if name in origins), f"{self._dataset.path}, line {last.line}")
        err.message = f"{err.message} (from {where})"
