"""YAML as rosbag2 writes it."""

from __future__ import annotations

import pytest

from pc2scan.files.yaml import dump_yaml, load_yaml


def test_block_style_in_the_order_given() -> None:
    value = {"b": [{"z": 1, "a": "ü" * 200}], "a": None, "none": []}
    text = dump_yaml(value)
    assert text == f"b:\n- z: 1\n  a: {'ü' * 200}\na: null\nnone: []\n"
    assert load_yaml(text) == value


@pytest.mark.parametrize(("text", "place"), [("a: [", "line 1"), ("a: 1\n b: 2", "line 2"), ("[" * 5000, "")])
def test_what_is_no_yaml(text: str, place: str) -> None:
    with pytest.raises(ValueError, match=f"is not valid YAML.*{place}"):
        load_yaml(text)


@pytest.mark.parametrize(
    "text", ["? [a, {b: c}]\n: d\n", "a: 2001-99-99", "a: -0x_", "a: !!int ''", "a: !!float x", "a: !!bool x", "a: ="]
)
def test_values_that_cannot_be_made(text: str) -> None:
    with pytest.raises(ValueError, match="is not valid YAML"):
        load_yaml(text)
