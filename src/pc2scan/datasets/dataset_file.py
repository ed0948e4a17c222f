"""The options of each recording: those of the call override those of a dataset file. All are checked beforehand.

A dataset file is YAML that gives options to the recordings of a dataset, by patterns.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pc2scan.errors import UsageError
from pc2scan.options.table import dataset_options
from pc2scan.options.values import FLAG, texts
from pc2scan.request.entries import entries_in, naming_place, read_text
from pc2scan.request.parameters import RIVALS
from pc2scan.requests import NAMED_FILES

from .jobs import JobRequest, request_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from pc2scan.request.entries import Entry

_EXAMPLE = "it has `defaults:`, `recordings:`, or both"


@dataclass(frozen=True)
class DatasetEntry:
    """Options for the recordings that a pattern matches.

    Attributes
    ----------
    place
        Where it begins in the file.
    patterns
        Globs; empty for the defaults, which match everything.
    keywords
        Options by name, as `pc2scan.datasets.jobs.request_of` reads them.
    origins
        Where each option comes from.
    skip
        Whether the recordings are skipped; None if the entry does not have it.
    """

    place: str
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


def load_dataset_file(path: Path) -> list[DatasetEntry]:
    """Return the entries of a dataset file, the defaults first.

    Raises
    ------
    UsageError
        If it cannot be read, is not YAML, or has an unknown key or a wrong value; the message names the line.
    """
    sections = entries_in(read_text(path, _EXAMPLE), path, _EXAMPLE).mapping(
        "the file", ("defaults", "recordings"), _EXAMPLE
    )
    entries = [_entry(sections["defaults"], path.parent)] if "defaults" in sections else []
    if (recordings := sections.get("recordings")) and recordings.value is not None:
        if not isinstance(recordings.value, list):
            message = f"{recordings.place}: recordings must be a list, got {recordings.shown}"
            raise UsageError(message, hint="write '- match: PATTERN' for each entry")
        entries += [_entry(entry, path.parent, "match", "skip") for entry in recordings.value]
    return entries


def _entry(entry: Entry, folder: Path, *more: str) -> DatasetEntry:
    options = dataset_options()
    kinds = {"match": texts(), "skip": FLAG, **{name: option.value for name, option in options.items()}}
    given = entry.mapping("an entry of recordings" if more else "defaults", (*more, *options), "")
    values = {name: value.read(name, kinds[name], folder) for name, value in given.items()}
    patterns, skip = values.pop("match", ()), values.pop("skip", None)
    if more and not patterns:
        raise UsageError(f"{entry.place}: an entry of recordings has no match", hint="write 'match: robot1/**' in it")
    return DatasetEntry(entry.place, patterns, values, {name: given[name].place for name in values}, skip)


def _expression(pattern: str) -> str:
    """Translate a glob: ``*`` matches within one name, ``**`` any number of folders; a folder matches its content."""
    pattern = pattern.removeprefix("./").removesuffix("/")
    parts = []
    position = 0
    for wildcard in re.finditer(r"\*\*/|\*\*|\*|\?|\[[^\]/]+\]", pattern):
        parts.append(re.escape(pattern[position : wildcard.start()]))
        match token := wildcard[0]:
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
        position = wildcard.end()
    parts.append(re.escape(pattern[position:]))
    anywhere = "" if "/" in pattern else "(?:.*/)?"
    return f"{anywhere}{''.join(parts)}(?:/.*)?"


# --- The options of each recording ---


class Choices:
    """Finds the options of recordings. Recordings with the same options share one request.

    Parameters
    ----------
    entries
        Those of the dataset file.
    keywords
        Options of the call. They override those of the file.
    origins
        Where each option of the call comes from, for errors.

    Raises
    ------
    UsageError
        If the options of the call alone, or with the defaults of the file, are wrong.
    """

    def __init__(self, entries: list[DatasetEntry], keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        self._entries = entries
        self._call = DatasetEntry("", keywords=keywords, origins=origins)
        self._made: dict[tuple[int, ...], JobRequest | None] = {}
        self._request(tuple(number for number, entry in enumerate(entries) if not entry.patterns))

    def of(self, keys: Iterable[str]) -> dict[str, JobRequest | None]:
        """Return the options of recordings, by key; None for those that are skipped.

        Raises
        ------
        UsageError
            If options are wrong; the message names the line of the dataset file.
        """
        entries = list(enumerate(self._entries))
        return {key: self._request(tuple(number for number, entry in entries if entry.matches(key))) for key in keys}

    def warnings(self, keys: Iterable[str]) -> list[str]:
        """Return warnings about the dataset file and the options."""
        listed = list(keys)
        unused = [
            f"{entry.place}: matches no recording: {', '.join(entry.patterns)}"
            for entry in self._entries
            if not any(map(entry.matches, listed))
        ]
        notes = [note for request in self._made.values() if request for note in request.options.notes]
        return [*unused, *dict.fromkeys(notes)]

    def _request(self, numbers: tuple[int, ...]) -> JobRequest | None:
        """Return the options of a recording that these entries of the file apply to."""
        if numbers not in self._made:
            keywords: dict[str, Any] = {}
            origins: dict[str, str] = {}
            skip = False
            for entry in (*(self._entries[number] for number in numbers), self._call):
                for name in entry.keywords:
                    # Another option that means the same is overridden, too.
                    keywords.pop(RIVALS.get(name, ""), None)
                    origins.pop(name, None)
                keywords |= entry.keywords
                origins |= entry.origins
                skip = skip if entry.skip is None else entry.skip
            last = self._entries[numbers[-1]].place if numbers else ""
            files = (
                (path, origins[name], name)
                for name in NAMED_FILES
                if name in keywords and name not in self._call.keywords
                for path in (keywords[name] if isinstance(keywords[name], tuple) else (keywords[name],))
                if dataset_options()[name].value.is_path(str(path))
            )
            with naming_place(origins, last, files):
                self._made[numbers] = None if skip else request_of(keywords, origins)
        return self._made[numbers]
