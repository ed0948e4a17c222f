"""JSON schemas that are shipped, and whether documents have what they say."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

__all__ = ["SCHEMAS", "violations"]

SCHEMAS = {
    name: json.loads((files("pc2scan") / folder / name).read_text("utf-8"))
    for folder, name in (("", "results.schema.json"), ("batch", "manifest.schema.json"))
}
TYPES: dict[str, Any] = {
    "null": type(None),
    "string": str,
    "integer": int,
    "number": (int, float),
    "boolean": bool,
    "array": list,
    "object": dict,
}


def violations(value: Any, schema: dict[str, Any], root: dict[str, Any], place: str = "$") -> list[str]:
    """Return what a schema does not allow of a document. Only the keywords that our schemas use are supported."""
    assert schema.keys() <= {
        *("$schema", "$id", "$ref", "$defs", "title", "description", "type", "enum", "anyOf", "minimum", "minLength"),
        *("properties", "required", "additionalProperties", "minProperties", "items", "minItems", "maxItems"),
    }
    if reference := schema.get("$ref"):
        file, _, pointer = reference.partition("#")
        root = SCHEMAS[file] if file else root
        target = root
        for step in pointer.split("/")[1:]:
            target = target[step]
        return violations(value, target, root, place)
    if options := schema.get("anyOf"):
        tried = [violations(value, each, root, place) for each in options]
        return [] if [] in tried else [f"{place}: none of {len(tried)}", *tried[0]]
    kinds = schema.get("type", list(TYPES))
    kinds = [kinds] if isinstance(kinds, str) else kinds
    fits = any(isinstance(value, TYPES[kind]) and (not isinstance(value, bool) or kind == "boolean") for kind in kinds)
    if not fits or value not in schema.get("enum", [value]):
        return [f"{place}: {value!r} is not {schema.get('enum', kinds)}"]
    if "minimum" in schema and value < schema["minimum"]:
        return [f"{place}: {value!r} is less than {schema['minimum']}"]
    if isinstance(value, str) and len(value) < schema.get("minLength", 0):
        return [f"{place}: {value!r} is too short"]
    found = []
    if isinstance(value, dict):
        known, more = schema.get("properties", {}), schema.get("additionalProperties", True)
        if len(value) < schema.get("minProperties", 0):
            found.append(f"{place}: {len(value)} keys")
        found += [f"{place}: {name} is missing" for name in schema.get("required", ()) if name not in value]
        for name, each in value.items():
            if name in known or isinstance(more, dict):
                found += violations(each, known.get(name, more), root, f"{place}.{name}")
            elif not more:
                found.append(f"{place}: {name} is too much")
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            found.append(f"{place}: {len(value)} items")
        for number, each in enumerate(value):
            found += violations(each, schema.get("items", {}), root, f"{place}[{number}]")
    return found
