"""Plausible mistakes are said, with what to type, and their sound twins are told nothing."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

import pytest

from support.batches import in_this_process
from support.command import Finished, run
from support.situations import SITUATIONS, Situation

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def done(command: str, src: Path) -> Finished:
    words = [word.format(src=src.name, out="out.mcap") for word in shlex.split(command)]
    with in_this_process():
        return run(*words, cwd=src.parent)


def built(build: Callable[[Path], Path], folder: Path) -> Path:
    folder.mkdir()
    return build(folder)


@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda situation: situation.name)
def test_a_mistake_is_said_and_its_sound_twin_is_silent(situation: Situation, tmp_path: Path) -> None:
    source = built(situation.build, tmp_path / "mistaken")
    for command, said in situation.commands:
        found = done(command, source)
        assert said in " ".join((found.stdout + found.stderr).split()), (command, found)
    sound = built(situation.sound_build or situation.build, tmp_path / "sound")
    for command in situation.sound_commands:
        found = done(command, sound)
        assert (found.status, [word for word in ("warning:", "error:", "hint:") if word in found.stderr]) == (0, []), (
            found
        )
