"""The page of the library, which the site has, and the types of keywords."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from typing import get_args

import pytest

import pc2scan
from pc2scan.core.presets import PRESETS
from pc2scan.options.table import GROUPS
from support import ROOT
from support.command import environment


def test_the_page_has_functions_with_their_keywords() -> None:
    script = "import sys; sys.path.insert(0, 'docs/site'); import python_page; print(python_page.page())"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, env=environment(), capture_output=True, text=True, check=True
    )
    sections = {part.partition("\n")[0]: part for part in done.stdout.split("\n## ")[1:]}
    assert sections.keys() == set(pc2scan.__all__) - {"errors"}
    for name in ("convert", "batch", "export", "golden", "tf"):
        known = inspect.signature(getattr(pc2scan, name)).parameters
        assert all(f"    {keyword}" in sections[name] for keyword in known)
    assert "Unpack" not in done.stdout


def test_keywords_with_few_words_have_types_of_these() -> None:
    """So that a type checker finds ``preset="slamtoolbox"``."""
    annotations = [
        (name, each) for groups in GROUPS.values() for group in groups for name, each in group.__annotations__.items()
    ]
    typed = {}
    for name, each in annotations:
        words = {word for part in (each.__origin__, *get_args(each.__origin__)) for word in (part, *get_args(part))}
        typed[name] = {re.sub(r"=\d", "=N", word) for word in words if isinstance(word, str) and word}
        if each.__metadata__[0].value.words and typed[name]:
            assert typed[name] == set(each.__metadata__[0].value.words), name
    assert typed["preset"] == PRESETS.keys()
    assert {name for name, words in typed.items() if words} >= {
        "preset",
        "to",
        "storage",
        "compression",
        "geometry",
        "stamp",
    }


def test_a_stamp_in_seconds_is_refused() -> None:
    tree = pc2scan.tf(ROOT / "fixtures" / "hall.bag")
    with pytest.raises(
        TypeError, match=r"stamp_ns is 1700000000\.1 \(float\), it must be a whole number of nanoseconds"
    ):
        tree.lookup("odom", "lidar", 1700000000.1)  # type: ignore[arg-type]
    assert tree.lookup("odom", "lidar", 1700000000_100000000).translation.shape == (3,)
