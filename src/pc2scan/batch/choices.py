"""The options of each recording: those of the call override those of the dataset file. All are checked beforehand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pc2scan.errors import ParameterError, UsageError
from pc2scan.pipeline.concealed import is_about, without_content
from pc2scan.pipeline.parameters import RIVALS

from .plan import Choice
from .request import request_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from .dataset_file import DatasetFile


class Choices:
    """Finds the options of recordings.

    Parameters
    ----------
        dataset
            The dataset file.
        keywords
        Options of the call. They override those of the file.
        origins
            Where each option comes from, for errors.
    """

    def __init__(self, dataset: DatasetFile, keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        self._dataset = dataset
        self._keywords = keywords
        self._origins = origins
        self._made: dict[tuple[int, ...], Choice] = {}

    def check(self) -> None:
        """Raise if the options of the call alone, or with the defaults of the file, are wrong."""
        defaults = tuple(number for number, entry in enumerate(self._dataset.entries) if not entry.patterns)
        self._choice(defaults)

    def of(self, keys: Iterable[str]) -> dict[str, Choice]:
        """Return the options of recordings, by key.

        Raises
        ------
        UsageError
            If options are wrong; the message names the line of the dataset file.
        """
        return {key: self._choice(self._dataset.matching(key)) for key in keys}

    def warnings(self, keys: Iterable[str]) -> list[str]:
        """Return warnings about the dataset file and the options."""
        listed = list(keys)
        unused = [
            f"{self._dataset.path}, line {entry.line}: matches no recording: {', '.join(entry.patterns)}"
            for entry in self._dataset.entries
            if not any(map(entry.matches, listed))
        ]
        notes = [note for choice in self._made.values() if choice.request for note in choice.request.notes]
        return [*unused, *dict.fromkeys(notes)]

    def _choice(self, numbers: tuple[int, ...]) -> Choice:
        if numbers not in self._made:
            keywords, origins, skip = self._dataset.combined(numbers)
            for name in self._keywords:
                keywords.pop(RIVALS.get(name, ""), None)
            keywords |= self._keywords
            origins = {name: origin for name, origin in origins.items() if name not in self._keywords} | dict(
                self._origins
            )
            if skip:
                self._made[numbers] = Choice(None)
            else:
                try:
                    request = request_of(keywords, origins)
                    self._made[numbers] = Choice(request, request.digest())
                except UsageError as err:
                    self._refuse_to_quote(err, keywords, origins)
                    self._add_origin(err, numbers, origins)
                    raise
        return self._made[numbers]

    def _refuse_to_quote(self, err: UsageError, keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        """Raise another error if one is about a file that the dataset file names, and may quote it."""
        for name in ("params_file", "static_tf_file", "scans"):
            if name in keywords and name not in self._keywords and is_about(err, keywords[name]):
                raise without_content(err, keywords[name], origins[name], name) from None

    def _add_origin(self, err: UsageError, numbers: tuple[int, ...], origins: Mapping[str, str]) -> None:
        """Add the line of the dataset file that has the wrong option to the message."""
        if not numbers or any(origin in err.message for origin in origins.values()):
            return
        text = f"{err.message} {err.hint or ''}"
        named = [name for name in origins if f"`{name}`" in text or f"`{name}=" in text]
        if isinstance(err, ParameterError) and err.name in origins:
            named.insert(0, err.name)
        # Some messages quote the wrong value (a transform, a topic) instead of the option.
        keywords = self._dataset.combined(numbers)[0]
        named += [
            name
            for name, value in keywords.items()
            if any(repr(text) in err.message for text in (value if isinstance(value, tuple) else (value,)))
        ]
        entry = self._dataset.entries[numbers[-1]]
        where = next((origins[name] for name in named if name in origins), f"{self._dataset.path}, line {entry.line}")
        err.message = f"{err.message} (from {where})"
