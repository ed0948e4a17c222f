"""Turns Typer's usage errors into errors of the same style as all others."""

from __future__ import annotations

import os
import re
import shlex
from typing import TYPE_CHECKING

# Typer has no public place for these; pyproject.toml allows only versions in which they are here.
from typer._click.exceptions import BadOptionUsage, BadParameter, MissingParameter, NoSuchOption
from typer._click.exceptions import UsageError as TyperUsageError

from pc2scan.errors import UsageError
from pc2scan.options.table import GROUPS, instead_of, options_of
from pc2scan.text import did_you_mean

from .render import as_typed

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Typer's names of types, and ours.
_KINDS = {
    "a valid int": "a whole number",
    "a valid int range": "a whole number",
    "a valid float": "a number",
    "a valid float range": "a number",
}

#: How similar an option must be to what was typed to be suggested, from 0 to 1.
_ALIKE = 0.6


def in_our_words(err: TyperUsageError, typed: Sequence[str]) -> UsageError:
    """Convert an error of Typer to one of ours; ``typed`` are the arguments, including the command's name."""
    # The command is taken from the arguments, because Typer's error lacks it if the parser itself fails.
    command = err.ctx.command_path if err.ctx else " ".join(("pc2scan", *typed[:1]))
    hint = f"{command} --help shows what it takes"
    if isinstance(err, NoSuchOption):
        near_options = _nearest_first(err.option_name, err.possibilities or ())
        if instead := _instead(typed[0] if typed else "", err.option_name):
            hint = instead
        elif near_options:
            hint = f"did you mean {' or '.join(near_options)}?"
        elif err.option_name == "--json":
            hint = "--report report.json writes a report as JSON"
        elif file := next((word for word in typed if word.startswith("-") and os.path.lexists(word)), None):
            hint = f"for the file of this name, type ./{file}"
        return UsageError(f"there is no option {err.option_name}", hint=hint)
    if isinstance(err, MissingParameter) and err.param is not None:
        is_option = err.param.param_type_name == "option"
        name = "/".join(err.param.opts) if is_option else err.param.human_readable_name
        return UsageError(f"{name} is missing", hint=hint)
    text = err.message.rstrip(".")
    if unreadable := re.search(r"(?:Path|File|Directory) '(.*)' is not readable$", text):
        return UsageError("permission denied", path=unreadable[1], hint="ls -l shows who owns it and who may read it")
    if isinstance(err, BadParameter) and err.param is not None:
        value, is_not, kind = text.rpartition(" is not ")
        near = did_you_mean(value.strip("'"), re.findall(r"'([^']*)'", kind)) if kind.startswith("one of") else ""
        kind = re.sub(r"^in the range x>=(\S+)$", r"\1 or more", kind)
        spellings = err.param.opts if err.param.param_type_name == "option" else [err.param.human_readable_name]
        return UsageError(f"{_spelling(spellings, typed)}: {value}{is_not}{_KINDS.get(kind, kind)}", hint=near or hint)
    if isinstance(err, BadOptionUsage):
        return UsageError(f"{err.option_name} {text.removeprefix(f'Option {err.option_name!r} ')}", hint=hint)
    text, _, near = text.partition(". Did you mean ")
    if typed and f"No such command {typed[0]!r}" == text and os.path.lexists(typed[0]):
        hint = f"the command comes first: pc2scan info {shlex.quote(typed[0])}"
    return UsageError(text[:1].lower() + text[1:], hint=f"did you mean {near}" if near else hint)


def _instead(command: str, typed: str) -> str:
    """Return what to use instead of an option that only other commands have."""
    names = [name for name in (typed.strip("-").replace("-", "_"),) if command in GROUPS]
    names += [option.name for other in GROUPS for option in options_of(other).values() if option.spelling == typed]
    return next((as_typed(text) for name in names if (text := instead_of(command, name))), "")


def _nearest_first(typed: str, options: Sequence[str]) -> list[str]:
    """Return the options similar to the typed one; if one differs only in its underscores, only that one."""
    from difflib import SequenceMatcher

    plain = typed.replace("_", "-").lower()
    if plain in options:
        return [plain]
    likeness = {option: SequenceMatcher(None, plain.strip("-"), option.strip("-")).ratio() for option in options}
    return sorted((option for option in options if likeness[option] >= _ALIKE), key=lambda option: -likeness[option])


def _spelling(spellings: Sequence[str], typed: Sequence[str]) -> str:
    """Return how an option was typed last, which is what counts: ``-j``, ``-j4``, ``--jobs=4``."""
    for word in reversed(typed):
        for spelling in spellings:
            joined = spelling + "=" if spelling.startswith("--") else spelling
            if word == spelling or word.startswith(joined):
                return spelling
    return spellings[0]
