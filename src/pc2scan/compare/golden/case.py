"""Reads a golden case: a folder with a conversion's input, options and expected output."""

from __future__ import annotations

import os
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from pc2scan.compare.rules import Rules
from pc2scan.errors import UsageError
from pc2scan.files.places import missing_hint
from pc2scan.files.source import open_text
from pc2scan.files.yaml import MAX_CHARACTERS, load_yaml
from pc2scan.text import did_you_mean, nearest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

EXPECTED_TEXT = "expected.txt"
_EXPECTED = (EXPECTED_TEXT, "expected.bag", "expected.mcap", "expected")
_INPUTS = ("input.bag", "input.mcap", "input.db3", "input")
SETTINGS = "case.yaml"
_PARAMS = "params.yaml"


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _are_texts(value: object) -> bool:
    return all(isinstance(part, str) for part in _listed(value))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _are_numbers(value: object) -> bool:
    if not isinstance(value, dict):
        return _is_number(value)
    return all(isinstance(name, str) and _is_number(number) for name, number in value.items())


#: The keys of ``case.yaml``: whether a value is right, and what it must be.
KEYS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "input": (lambda value: bool(value) and _are_texts(value), "a path or a list of paths"),
    "params": (lambda value: isinstance(value, str), "a path"),
    "arguments": (
        lambda value: isinstance(value, list) and all(isinstance(part, str | int | float) for part in value),
        "a list, such as [--topic, /points:=/scan]",
    ),
    "exit_status": (lambda value: type(value) is int, "a whole number"),
    "all_topics": (lambda value: type(value) is bool, "true or false"),
    **dict.fromkeys(("atol", "rtol"), (_are_numbers, "a number, or numbers by name: {x: 1.0e-6}")),
    "allow_beams": (_is_number, "a number"),
    "ignore": (_are_texts, "a name or a list of names"),
}


@dataclass(frozen=True, slots=True)
class Case:
    """A conversion and its expected output.

    Attributes
    ----------
    folder
        The case's folder.
    inputs
        Recordings; several are merged into one.
    params
        The parameter file; None for upstream's defaults.
    expected
        ``expected.txt`` (see `pc2scan.compare.scan_text`) or a recording; None if there is none yet.
    arguments
        Further options of ``pc2scan convert``, not yet checked; ``{case}`` in them is replaced by the folder.
    exit_status
        The expected exit status of the conversion.
    all_topics
        Whether all topics are compared, and not only converted ones.
    rules
        The rules of the comparison.
    """

    folder: Path
    inputs: tuple[Path, ...]
    params: Path | None
    expected: Path | None
    arguments: tuple[str, ...]
    exit_status: int
    all_topics: bool
    rules: Rules


def is_case(folder: Path) -> bool:
    """Whether a folder is a case, complete or not."""
    return any((folder / name).exists() for name in (SETTINGS, _PARAMS, *_INPUTS, *_EXPECTED))


def case_folders(folder: Path, pattern: str = "") -> list[tuple[str, Path]]:
    """Find the cases in a folder, at any depth; the folder itself may be one.

    Parameters
    ----------
    pattern
        A part of the name, or a glob for the whole name; empty for every case.

    Returns
    -------
    list of (name, folder)
        Sorted; a name is the path relative to the folder.

    Raises
    ------
    UsageError
        If there is no such folder, or no case with such a name in it.
    """
    try:
        if not os.path.lexists(folder):
            raise UsageError("does not exist", path=folder, hint=missing_hint(folder))
        if not folder.is_dir():
            raise UsageError("is not a folder", path=folder, hint="give the folder with the cases")
        if is_case(folder):
            cases = [(folder.resolve().name, folder)]
        else:
            cases = [(case.relative_to(folder).as_posix(), case) for case in _folders_below(folder)]
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=err.filename or folder) from err
    if not cases:
        raise UsageError(
            "has no cases", path=folder, hint="a case is a folder with input.bag (or .mcap, ...) and params.yaml"
        )
    chosen = [(name, case) for name, case in cases if pattern in name or fnmatchcase(name, pattern)]
    if not chosen:
        near = did_you_mean(pattern, [name for name, _ in cases])
        raise UsageError(f"none of its {len(cases)} cases has {pattern!r} in its name", path=folder, hint=near or None)
    return chosen


def _folders_below(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
            if is_case(path):
                yield path
            else:
                yield from _folders_below(path)


def load_case(folder: Path) -> Case:
    """Read a case from its folder.

    Raises
    ------
    UsageError
        If a file is missing or exists twice, or ``case.yaml`` has a wrong value.
    """
    try:
        _refuse_misnamed(folder)
        settings = _settings(folder / SETTINGS)
        return _case_of(folder, settings)
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=err.filename or folder) from err


def _refuse_misnamed(folder: Path) -> None:
    """Raise if a file's name is a misspelling of one that would be read: a ``param.yaml`` would silently be ignored."""
    names = {entry.name for entry in folder.iterdir()}
    kinds = ((SETTINGS,), (_PARAMS,), _INPUTS, _EXPECTED)
    missing = [name for kind in kinds if not names & {*kind} for name in kind]
    for name in sorted(names - {name for kind in kinds for name in kind}):
        if near := nearest(name, missing):
            raise UsageError(f"{name} is not read", path=folder, hint=f"did you mean {near}?")


def _settings(path: Path) -> dict[str, Any]:
    """Return the checked content of ``case.yaml``; a value that may be a list is one."""
    try:
        with open_text(path) as file:
            # One more than allowed, so that longer text is refused.
            settings = load_yaml(file.read(MAX_CHARACTERS + 1)) or {}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as err:
        raise UsageError(f"cannot be read: {err}", path=path) from err
    known = f"the keys are {', '.join(KEYS)}"
    if not isinstance(settings, dict):
        raise UsageError("is not a mapping", path=path, hint=known)
    for key, value in settings.items():
        if key not in KEYS:
            hint = f"{did_you_mean(str(key), KEYS)} {known}".strip()
            raise UsageError(f"unknown key {key!r}", path=path, hint=hint)
        is_right, what = KEYS[key]
        if not is_right(value):
            raise UsageError(f"{key} is {value!r}, it must be {what}", path=path)
    return settings


def _case_of(folder: Path, settings: dict[str, Any]) -> Case:
    def named(key: str) -> tuple[Path, ...]:
        """Return files that the settings name. A missing one is always an error, even if the case expects a failure."""
        paths = tuple(folder / name for name in _listed(settings[key]))
        if missing := [path for path in paths if not path.exists()]:
            hint = "paths are relative to the case's folder"
            text = f"names {missing[0].relative_to(folder)}, which does not exist"
            raise UsageError(text, path=folder / SETTINGS, hint=hint)
        return paths

    inputs = named("input") if "input" in settings else _only(folder, _INPUTS)
    if not inputs:
        raise UsageError("has no input", path=folder, hint=f"{', '.join(_INPUTS)}, or 'input:' in {SETTINGS}")
    params = named("params") if "params" in settings else _only(folder, (_PARAMS,))
    expected = _only(folder, _EXPECTED)
    if expected and any(path.samefile(expected[0]) for path in (*inputs, *params)):
        raise UsageError("is a file of a case", path=expected[0])
    tolerances = {key: settings.get(key, {}) for key in ("atol", "rtol")}
    by_name = {key: value if isinstance(value, dict) else {"": value} for key, value in tolerances.items()}
    share, ignore = settings.get("allow_beams", 0.0), frozenset(_listed(settings.get("ignore", [])))
    try:
        rules = Rules(**by_name, allow_beams=share, ignore=ignore)
    except UsageError as err:
        err.path = folder / SETTINGS
        raise
    return Case(
        folder=folder,
        inputs=inputs,
        params=params[0] if params else None,
        expected=expected[0] if expected else None,
        arguments=tuple(str(part).replace("{case}", str(folder)) for part in settings.get("arguments", [])),
        exit_status=settings.get("exit_status", 0),
        all_topics=settings.get("all_topics", False),
        rules=rules,
    )


def _only(folder: Path, names: tuple[str, ...]) -> tuple[Path, ...]:
    """Return the one of several names that exists; empty for none."""
    paths = tuple(folder / name for name in names if (folder / name).exists())
    if len(paths) > 1:
        raise UsageError(f"has {' and '.join(path.name for path in paths)}", path=folder, hint="remove all but one")
    return paths
