"""What was typed, as the arguments of a command and the options of a call."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pc2scan.errors import UsageError
from pc2scan.files.urls import local_path, path_or_url
from pc2scan.options.call import Options
from pc2scan.options.option import Parameter
from pc2scan.options.table import options_of
from pc2scan.request.parameters import plain_scalar

from .commands import COMMANDS

if TYPE_CHECKING:
    from collections.abc import Mapping


def arguments_of(command: str, typed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a command's function that are not in the table of options.

    Sources are paths and URLs. The destination stays text, because a slash at its end makes it a folder.

    Raises
    ------
    UsageError
        If one is missing or empty, or if an option is typed twice.
    """
    arguments: dict[str, Any] = {}
    for argument in COMMANDS[command].arguments:
        value, shown = typed.get(argument.name), argument.shown
        if value is None and argument.required:
            raise UsageError(f"{shown} is missing", hint=f"pc2scan {command} --help shows what it takes")
        if argument.spellings and isinstance(value, list):
            if len(value) > 1:
                raise UsageError(f"{shown} is given twice, but has only one value", hint="type only one of them")
            value = value[0]
        if value is not None and argument.is_path:
            name = shown.removesuffix("...")
            texts = [local_path(text, name) for text in (value if isinstance(value, list) else [value])]
            paths = texts if argument.spellings else list(map(path_or_url, texts))
            value = paths if isinstance(value, list) else paths[0]
        arguments[argument.name] = value
    return arguments


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
        elif option.value.kind == "switch":
            words[key] = text == "local" or text
    return Options(name, words, origins)
