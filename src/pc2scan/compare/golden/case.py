"""Reads a golden case: a folder with a conversion's input, options and expected output."""

from __future__ import annotations

import os
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.compare.rules import Rules
from pc2scan.errors import UsageError
from pc2scan.files.ownership import InputPath
from pc2scan.files.places import missing_hint
from pc2scan.files.source import open_text
from pc2scan.files.yaml import MAX_CHARACTERS, load_yaml
from pc2scan.text import did_you_mean, nearest

if TYPE_CHECKING:
    from collections.abc import Iterator

EXPECTED_TEXT = "expected.txt"
_EXPECTED = (EXPECTED_TEXT, "expected.bag", "expected.mcap", "expected")
_INPUTS = ("input.bag", "input.mcap", "input.db3", "input")
SETTINGS = "case.yaml"
_PARAMS = "params.yaml"
#: The keys of ``case.yaml``.
KEYS = ("input", "params", "arguments", "exit_status", "all_topics", "atol", "rtol", "allow_beams", "ignore")


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

    def new_expected(self) -> Path:
        """Return where to write the expected output: in its present form; if there is none, as text where possible."""
        return self.expected or self.folder / ("expected.mcap" if self.all_topics else EXPECTED_TEXT)

    def read_files(self) -> list[InputPath]:
        """Return the files that its conversion reads: recordings, parameters, settings, and those in arguments."""
        values = [part.partition("=")[2] if part.startswith("-") else part for part in self.arguments]
        # Any argument may be a path; only those that exist are returned.
        named = [Path(value) for value in values if os.path.lexists(value)]
        paths = [*self.inputs, *filter(None, (self.params,)), self.folder / SETTINGS, *named]
        return [InputPath(path, "file of a case") for path in paths]


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
            found = [(folder.resolve().name, folder)]
        else:
            found = [(case.relative_to(folder).as_posix(), case) for case in _folders_below(folder)]
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=err.filename or folder) from err
    if not found:
        raise UsageError(
            "has no cases", path=folder, hint="a case is a folder with input.bag (or .mcap, ...) and params.yaml"
        )
    chosen = [(name, case) for name, case in found if pattern in name or fnmatchcase(name, pattern)]
    if not chosen:
        near = did_you_mean(pattern, [name for name, _ in found])
        raise UsageError(f"none of its {len(found)} cases has {pattern!r} in its name", path=folder, hint=near or None)
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
        return _case_of(folder, _settings(folder / SETTINGS))
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=err.filename or folder) from err


def _case_of(folder: Path, settings: dict[str, Any]) -> Case:
    _refuse_misnamed(folder)
    return Case(
        folder=folder,
        inputs=_inputs(folder, settings.get("input")),
        params=_params(folder, settings.get("params")),
        expected=_only(folder, _EXPECTED),
        arguments=_arguments(folder, settings.get("arguments", [])),
        exit_status=_setting(folder, settings, "exit_status", int, 0),
        all_topics=_setting(folder, settings, "all_topics", bool, False),
        rules=_rules(folder, settings),
    )


def _refuse_misnamed(folder: Path) -> None:
    """Raise if a file's name is a misspelling of one that would be read: a ``param.yaml`` would silently be ignored."""
    there = {entry.name for entry in folder.iterdir()}
    kinds = ((SETTINGS,), (_PARAMS,), _INPUTS, _EXPECTED)
    missing = [name for kind in kinds if not there & {*kind} for name in kind]
    for name in sorted(there - {name for kind in kinds for name in kind}):
        if near := nearest(name, missing):
            raise UsageError(f"{name} is not read", path=folder, hint=f"did you mean {near}?")


def _settings_error(folder: Path, message: str, hint: str | None = None) -> UsageError:
    return UsageError(message, path=folder / SETTINGS, hint=hint)


def _settings(path: Path) -> dict[str, Any]:
    try:
        with open_text(path) as file:
            # One more than allowed, so that longer text is refused.
            text = file.read(MAX_CHARACTERS + 1)
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError) as err:
        raise UsageError(f"cannot be read: {err}", path=path) from err
    try:
        settings = load_yaml(text)
    except ValueError as err:
        raise UsageError(str(err), path=path) from err
    if settings is None:
        return {}
    if not isinstance(settings, dict):
        raise UsageError("is not a mapping", path=path, hint=f"the keys are {', '.join(KEYS)}")
    if unknown := [key for key in settings if key not in KEYS]:
        near = did_you_mean(str(unknown[0]), KEYS)
        hint = f"{near} the keys are {', '.join(KEYS)}".strip()
        raise UsageError(f"unknown key {unknown[0]!r}", path=path, hint=hint)
    return settings


def _setting(folder: Path, settings: dict[str, Any], key: str, kind: type, default: Any) -> Any:
    value = settings.get(key, default)
    if type(value) is not kind:
        raise _settings_error(
            folder, f"{key} is {value!r}, it must be {'true or false' if kind is bool else 'a whole number'}"
        )
    return value


def _inputs(folder: Path, named: Any) -> tuple[Path, ...]:
    if named is None:
        found = _only(folder, _INPUTS)
        if found is None:
            raise UsageError("has no input", path=folder, hint=f"{', '.join(_INPUTS)}, or 'input:' in {SETTINGS}")
        return (found,)
    names = named if isinstance(named, list) else [named]
    if not names or not all(isinstance(name, str) for name in names):
        raise _settings_error(folder, f"input is {named!r}, it must be a path or a list of paths")
    return tuple(_existing_file(folder, name) for name in names)


def _params(folder: Path, named: Any) -> Path | None:
    if named is None:
        return folder / _PARAMS if (folder / _PARAMS).exists() else None
    if not isinstance(named, str):
        raise _settings_error(folder, f"params is {named!r}, it must be a path")
    return _existing_file(folder, named)


def _existing_file(folder: Path, name: str) -> Path:
    """Return a file that the settings name. A missing one is always an error, even if the case expects a failure."""
    path = folder / name
    if not path.exists():
        raise _settings_error(folder, f"names {name}, which does not exist", "paths are relative to the case's folder")
    return path


def _only(folder: Path, names: tuple[str, ...]) -> Path | None:
    """Return the one of several names that exists."""
    found = [folder / name for name in names if (folder / name).exists()]
    if len(found) > 1:
        raise UsageError(f"has {' and '.join(path.name for path in found)}", path=folder, hint="remove all but one")
    return found[0] if found else None


def _arguments(folder: Path, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or any(isinstance(part, (list, dict)) or part is None for part in value):
        raise _settings_error(folder, f"arguments is {value!r}, it must be a list", "such as [--topic, /points:=/scan]")
    parts = tuple(part if isinstance(part, str) else str(part) for part in value)
    return tuple(part.replace("{case}", str(folder)) for part in parts)


def _rules(folder: Path, settings: dict[str, Any]) -> Rules:
    ignore = settings.get("ignore", [])
    names = ignore if isinstance(ignore, list) else [ignore]
    share = settings.get("allow_beams", 0.0)
    if not _is_number(share):
        raise _settings_error(folder, f"allow_beams is {share!r}, it must be a number")
    try:
        return Rules(
            atol=_tolerance(folder, settings, "atol"),
            rtol=_tolerance(folder, settings, "rtol"),
            allow_beams=float(share),
            ignore=frozenset(map(str, names)),
        )
    except UsageError as err:
        raise _settings_error(folder, err.message, err.hint) from err


def _tolerance(folder: Path, settings: dict[str, Any], key: str) -> dict[str, float]:
    value = settings.get(key, {})
    named = value if isinstance(value, dict) else {"": value}
    if not all(isinstance(name, str) and _is_number(number) for name, number in named.items()):
        raise _settings_error(
            folder, f"{key} is {value!r}, it must be a number or numbers by name", "such as {x: 1.0e-6}"
        )
    return {name: float(number) for name, number in named.items()}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
