"""Reads a golden case: a folder with a conversion's input, options and expected output."""

from __future__ import annotations

import os
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from pc2scan.compare.rules import Rules
from pc2scan.errors import UsageError
from pc2scan.files.source import missing_hint, open_text
from pc2scan.files.yaml import MAX_CHARACTERS, load_yaml
from pc2scan.options.call import Options
from pc2scan.options.values import count, texts
from pc2scan.text import did_you_mean, nearest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

EXPECTED_TEXT = "expected.txt"
_EXPECTED = (EXPECTED_TEXT, "expected.bag", "expected.mcap", "expected")
_INPUTS = ("input.bag", "input.mcap", "input.db3", "input")
SETTINGS = "case.yaml"
_PARAMS = "params.yaml"

#: The keys of ``case.yaml``: those of a case, and options of ``diff``.
_COMPARISON = ("all_topics", "atol", "rtol", "allow_beams", "ignore")
_KEYS = ("input", "params", "arguments", "exit_status", *_COMPARISON)


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
    comparison
        The options of the comparison; with ``all_topics``, not only converted topics are compared.
    """

    folder: Path
    inputs: tuple[Path, ...]
    params: Path | None
    expected: Path | None
    arguments: tuple[str, ...]
    exit_status: int
    comparison: Options


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
    if not os.path.lexists(folder):
        raise UsageError("does not exist", path=folder, hint=missing_hint(folder))
    if not folder.is_dir():
        raise UsageError("is not a folder", path=folder, hint="give the folder with the cases")
    cases = [(case.relative_to(folder).as_posix(), case) for case in _cases_in(folder)]
    cases = [(folder.resolve().name if case == folder else name, case) for name, case in cases]
    if not cases:
        raise UsageError(
            "has no cases", path=folder, hint="a case is a folder with input.bag (or .mcap, ...) and params.yaml"
        )
    chosen = [(name, case) for name, case in cases if pattern in name or fnmatchcase(name, pattern)]
    if not chosen:
        near = did_you_mean(pattern, [name for name, _ in cases])
        raise UsageError(f"none of its {len(cases)} cases has {pattern!r} in its name", path=folder, hint=near or None)
    return chosen


def _cases_in(folder: Path) -> Iterator[Path]:
    if is_case(folder):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
            yield from _cases_in(path)


def load_case(folder: Path) -> Case:
    """Read a case from its folder.

    Raises
    ------
    UsageError
        If a file is missing or exists twice, or ``case.yaml`` has a wrong value.
    """
    path = folder / SETTINGS
    _refuse_misnamed(folder)
    settings = _settings(path)
    try:
        comparison = Options("diff", {key: value for key, value in settings.items() if key in _COMPARISON})
        Rules.of(comparison)
        named = {key: [folder / name for name in texts().read(key, settings.get(key))] for key in ("input", "params")}
        status = count().read("exit_status", settings.get("exit_status", 0))
        if not isinstance(arguments := settings.get("arguments", []), list):
            raise TypeError(f"arguments is {arguments!r}, it must be a list, such as [--topic, /points:=/scan]")
        # A missing file is always an error, even if the case expects a failure.
        for missing in (file for files in named.values() for file in files if not file.exists()):
            raise UsageError(f"names {missing.relative_to(folder)}, which does not exist")
    except (AttributeError, TypeError, UsageError) as err:
        raise UsageError(str(err), path=path, hint=getattr(err, "hint", None)) from err
    inputs = named["input"] or _only(folder, _INPUTS)
    if not inputs:
        raise UsageError("has no input", path=folder, hint=f"{', '.join(_INPUTS)}, or 'input:' in {SETTINGS}")
    params = named["params"] or _only(folder, (_PARAMS,))
    expected = _only(folder, _EXPECTED)
    if expected and any(file.samefile(expected[0]) for file in (*inputs, *params)):
        raise UsageError("is a file of a case", path=expected[0])
    return Case(
        folder=folder,
        inputs=tuple(inputs),
        params=params[0] if params else None,
        expected=expected[0] if expected else None,
        arguments=tuple(str(part).replace("{case}", str(folder)) for part in arguments),
        exit_status=status,
        comparison=comparison,
    )


def _refuse_misnamed(folder: Path) -> None:
    """Raise if a file's name is a misspelling of one that would be read: a ``param.yaml`` would silently be ignored."""
    names = {entry.name for entry in folder.iterdir()}
    kinds = ((SETTINGS,), (_PARAMS,), _INPUTS, _EXPECTED)
    missing = [name for kind in kinds if not names & {*kind} for name in kind]
    for name in sorted(names - {name for kind in kinds for name in kind}):
        if near := nearest(name, missing):
            raise UsageError(f"{name} is not read", path=folder, hint=f"did you mean {near}?")


def _settings(path: Path) -> dict[str, Any]:
    """Return the content of ``case.yaml``."""
    if not path.exists():
        return {}
    try:
        with open_text(path) as file:
            # One more than allowed, so that longer text is refused.
            settings = load_yaml(file.read(MAX_CHARACTERS + 1)) or {}
    except (OSError, ValueError) as err:
        raise UsageError(f"cannot be read: {err}", path=path) from err
    known = f"the keys are {', '.join(_KEYS)}"
    if not isinstance(settings, dict):
        raise UsageError("is not a mapping", path=path, hint=known)
    if unknown := [key for key in settings if key not in _KEYS]:
        raise UsageError(f"unknown key {unknown[0]!r}", path=path, hint=known)
    return settings


def _only(folder: Path, names: tuple[str, ...]) -> list[Path]:
    """Return the one of several names that exists; empty for none."""
    paths = [folder / name for name in names if (folder / name).exists()]
    if len(paths) > 1:
        raise UsageError(f"has {' and '.join(path.name for path in paths)}", path=folder, hint="remove all but one")
    return paths
