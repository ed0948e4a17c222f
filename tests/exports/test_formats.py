"""The table of formats, and the names of files."""

from __future__ import annotations

from pc2scan.exports.formats import FORMATS
from pc2scan.exports.run import file_names
from pc2scan.options.table import options_of


def test_the_command_offers_the_formats() -> None:
    assert options_of("export")["format"].value.words == tuple(FORMATS)


def test_names_are_safe_and_never_the_same() -> None:
    topics = [
        "/a/b",
        "/a_b",
        "/A_B",
        "/a_b_2",
        "/..",
        "/.",
        "/ö",
        "/" + "x" * 300,
        "/" + "x" * 301,
        "/a\0b\n/c",
    ]
    names = list(file_names(topics).values())
    assert len({name.lower() for name in names}) == len(topics)
    for name in names:
        assert name.isascii()
        assert name.replace("_", "").replace("-", "").replace(".", "").isalnum()
        assert len(name) < 130
        assert not name.startswith(".")
