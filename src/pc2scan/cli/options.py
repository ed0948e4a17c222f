"""What was typed, as the arguments of a command and the options of a call."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from pc2scan.errors import UsageError
from pc2scan.files.urls import UrlPath, local_path, path_or_url
from pc2scan.options import values
from pc2scan.options.call import Options
from pc2scan.options.option import Parameter
from pc2scan.options.table import options_of
from pc2scan.request.parameters import plain_scalar

from .commands import COMMANDS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def arguments_of(command: str, typed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a command's function that are not in the table of options.

    Raises
    ------
    UsageError
        If one is missing or empty, or if an option is typed twice.
    """
    arguments: dict[str, Any] = {}
    for argument in COMMANDS[command].arguments:
        value = typed.get(argument.name)
        shown = argument.shown
        if value is None:
            if argument.required:
                raise UsageError(f"{shown} is missing", hint=f"pc2scan {command} --help shows what it takes")
        elif argument.spellings and isinstance(value, list):
            if len(value) > 1:
                raise UsageError(f"{shown} is given twice, but has only one value", hint="type only one of them")
            value = value[0]
        if value is not None and argument.is_path:
            value = _paths(value, shown, is_output=bool(argument.spellings))
        arguments[argument.name] = value
    return arguments


def _paths(value: Any, shown: str, *, is_output: bool) -> Any:
    """Return paths and URLs; of an output as text, because a slash at its end makes it a folder."""
    if is_output:
        return local_path(value, shown)
    if isinstance(value, list):
        return [_source(text, shown.removesuffix("...")) for text in value]
    return _source(value, shown)


def _source(text: str, shown: str) -> Path:
    path = path_or_url(local_path(text, shown))
    if not isinstance(path, UrlPath) and not os.access(path, os.R_OK) and os.path.exists(path):  # noqa: PTH110  # names may be too long
        raise UsageError("permission denied", path=path, hint="ls -l shows who owns it and who may read it")
    return path


def call_options(name: str, typed: Mapping[str, Any]) -> Options:
    """Return what was typed as the options of a call."""
    words: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for key, option in options_of(name).items():
        if key not in typed:
            continue
        words[key] = text = typed[key]
        if isinstance(option, Parameter):
            if number := {"int": int, "float": float}.get(option.value.kind):
                try:
                    words[key] = number(text)
                except ValueError:
                    # In the notation of a parameter file.
                    words[key] = plain_scalar(text)
            origins[key] = option.negation if text is False else option.spelling
        elif isinstance(option.value, values.Switch):
            words[key] = text == "local" or text
        elif isinstance(option.value, values.Count):
            words[key] = _whole_number(key, text)
    return Options(name, words, origins)


def _whole_number(name: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise UsageError(f"`{name}` is {text!r}, it must be a whole number") from None
