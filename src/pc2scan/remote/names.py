"""Replaces the paths of local copies by URLs in what users see."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pc2scan.errors import Pc2ScanError


class Names:
    """Replaces local folders by the URLs of which they contain copies."""

    def __init__(self) -> None:
        self._urls: dict[str, str] = {}

    def add(self, folder: Path, url: str) -> None:
        """Replace paths in ``folder`` by URLs below ``url`` from now on."""
        self._urls[str(folder)] = url.rstrip("/")

    def text(self, text: str) -> str:
        """Replace the folders in a text."""
        for folder, url in self._urls.items():
            text = text.replace(folder, url)
        return text

    def of(self, value: Any) -> Any:
        """Replace the folders in a result: text, paths, lists, dictionaries and, in place, data classes."""
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, Path):
            text = self.text(str(value))
            return value if text == str(value) else ShownUrl(text)
        if type(value) is tuple or hasattr(value, "_fields"):
            items = map(self.of, value)
            return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
        if type(value) is list:
            return [self.of(item) for item in value]
        if type(value) is dict:
            return {key: self.of(item) for key, item in value.items()}
        if is_dataclass(value) and not isinstance(value, type):
            for each in fields(value):
                found = getattr(value, each.name)
                # Most values are numbers, and are skipped.
                if isinstance(found, str | Path | tuple | list | dict) or is_dataclass(found):
                    object.__setattr__(value, each.name, self.of(found))
        return value

    def error(self, err: Pc2ScanError) -> None:
        """Replace the folders in an error, in place."""
        err.message = self.text(err.message)
        err.args = (err.message,)
        err.path = None if err.path is None else self.text(str(err.path))
        err.hint = None if err.hint is None else self.text(err.hint)


class ShownUrl(str):
    """A URL in a result that otherwise has a path there."""

    __slots__ = ()

    @property
    def name(self) -> str:
        """The last part of the URL's path."""
        return self.rpartition("/")[2]
