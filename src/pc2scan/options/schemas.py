"""The JSON schemas of scans files and dataset files, made from the table of options.

``python -m pc2scan.options.schemas`` writes ``pipeline/scans.schema.json`` and ``batch/dataset.schema.json``, which are
for editors.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .table import PARAMETERS, dataset_options, output_options
from .values import PathName

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .option import Option

_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_TEXT = {"type": "string"}
_TEXTS = {"anyOf": [_TEXT, {"type": "array", "items": _TEXT, "minItems": 1}]}


def _properties(options: Iterable[Option]) -> dict[str, Any]:
    """Return the schemas of options, by name."""
    found = {}
    for option in options:
        text = option.help.replace("`", "")
        if isinstance(option.value, PathName):
            text += " Relative to this file."
        if option.default_text:
            text += f" Default: {option.default_text}."
        found[option.name] = {"description": text, **option.value.schema()}
    return found


def _options(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": ["object", "null"], "additionalProperties": False, "properties": properties}


def scans_schema() -> dict[str, Any]:
    """Return the JSON schema of scans files."""
    sources = {"description": "Topic, or topics, that become this output. Default: the only topic with clouds."}
    rows = [*output_options().values(), *PARAMETERS.values()]
    properties = {"sources": {**sources, **_TEXTS}, **_properties(rows)}
    listed = {
        "type": "object",
        "properties": {"topic": {"description": "The topic of the scans.", **_TEXT}, **properties},
        "required": ["topic"],
        "additionalProperties": False,
    }
    output = {"$ref": "#/$defs/output"}
    return {
        "$schema": _DRAFT,
        "title": "Scans file of pc2scan convert: several scans of one recording",
        "type": "object",
        "properties": {
            "defaults": {"description": "Values of all outputs that do not have their own.", **output},
            "scans": {
                "description": "The outputs, by their topics.",
                "anyOf": [
                    {"type": "object", "minProperties": 1, "additionalProperties": output},
                    {"type": "array", "minItems": 1, "items": listed},
                ],
            },
        },
        "required": ["scans"],
        "additionalProperties": False,
        "$defs": {"output": _options(properties)},
    }


def dataset_schema() -> dict[str, Any]:
    """Return the JSON schema of dataset files."""
    options = _properties(dataset_options().values())
    match = {
        "description": "Globs of recordings, relative to the folder that is searched. Without a slash, a name in any "
        "folder; ** is any number of folders.",
        **_TEXTS,
    }
    skip = {"description": "Do not convert these recordings.", "type": "boolean"}
    return {
        "$schema": _DRAFT,
        "title": "Dataset file of pc2scan batch",
        "type": "object",
        "additionalProperties": False,
        "properties": {
            "defaults": {"description": "Options for all recordings.", **_options(options)},
            "recordings": {
                "description": "Options for some recordings. All entries that match count; a later one overrides an "
                "earlier one, and all of them the defaults.",
                "type": ["array", "null"],
                "items": {
                    "type": "object",
                    "required": ["match"],
                    "additionalProperties": False,
                    "properties": {"match": match, "skip": skip, **options},
                },
            },
        },
    }


def schema_text(name: str) -> str:
    """Return a schema as the text of its file."""
    return json.dumps(scans_schema() if name == "scans" else dataset_schema(), indent=2) + "\n"


if __name__ == "__main__":
    for room, schema in (("pipeline", "scans"), ("batch", "dataset")):
        Path(__file__).parents[1].joinpath(room, f"{schema}.schema.json").write_text(schema_text(schema), "utf-8")
