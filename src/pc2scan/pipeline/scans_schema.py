"""The JSON schema of files with several outputs, made from the tables that such files are read by.

``python -m pc2scan.pipeline.scans_schema`` prints it; ``scans.schema.json`` is a copy for editors.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from .parameters import PARAMETERS, default_in_words
from .scans_file import OUTPUT_KEYS

if TYPE_CHECKING:
    from .parameters import Parameter
    from .scans_file import OutputKey

__all__ = ["schema", "schema_text"]

_TEXTS = {"type": "string"}
_KINDS: dict[str, dict[str, Any]] = {
    "text": _TEXTS,
    "texts": {"anyOf": [_TEXTS, {"type": "array", "items": _TEXTS, "minItems": 1}]},
    "flag": {"type": "boolean"},
    "number": {"type": "number"},
    "time": {"anyOf": [{"type": "number"}, _TEXTS]},
}


def _choice(choice: OutputKey) -> dict[str, Any]:
    kind = {"enum": list(choice.words)} if choice.words else _KINDS[choice.kind]
    return {"description": choice.help, **kind}


def _parameter(parameter: Parameter) -> dict[str, Any]:
    default = default_in_words(parameter)
    text = f"{parameter.help} Default: {default}." if default else parameter.help
    if parameter.kind == "str":
        return {"description": text, **({"enum": list(parameter.words)} if parameter.words else _TEXTS)}
    if parameter.kind == "bool":
        return {"description": text, "type": "boolean"}
    kind = {"type": "integer" if parameter.kind == "int" else "number"}
    # Numbers may have a unit, or be arithmetic: 180deg, pi/2, 50cm.
    in_words: list[dict[str, Any]] = [_TEXTS] if parameter.unit else []
    if parameter.words and not in_words:
        in_words = [{"enum": list(parameter.words)}]
    return {"description": text, **({"anyOf": [kind, *in_words]} if in_words else kind)}


def schema() -> dict[str, Any]:
    """Return the schema (JSON Schema, draft 2020-12)."""
    rows = [row for row in PARAMETERS.values() if "pointcloud_to_laserscan" in row.directions]
    properties = {name: _choice(choice) for name, choice in OUTPUT_KEYS.items()}
    properties |= {row.name: _parameter(row) for row in rows}
    output = {"$ref": "#/$defs/output"}
    listed = {
        "type": "object",
        "properties": {"topic": {"description": "The topic of the scans.", **_TEXTS}, **properties},
        "required": ["topic"],
        "additionalProperties": False,
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
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
        "$defs": {"output": {"type": ["object", "null"], "properties": properties, "additionalProperties": False}},
    }


def schema_text() -> str:
    """Return the schema as the text of its file."""
    return json.dumps(schema(), indent=2) + "\n"


if __name__ == "__main__":
    print(schema_text(), end="")  # noqa: T201  # its only purpose
