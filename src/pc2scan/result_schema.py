"""The JSON schema of results, made from their classes and docstrings.

``python -m pc2scan.result_schema`` writes ``results.schema.json``, which is for programs that read results.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from collections import abc
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, ForwardRef, Literal, Union, get_args, get_origin

from .batch.summary import BatchReport
from .compare.result import Difference
from .core.rule import PointCounts
from .errors import Pc2ScanError
from .export.report import ExportReport
from .golden.result import GoldenReport
from .inspect.check import Check
from .inspect.info import Info
from .inspect.tf import FrameTree, Lookup
from .look.map_result import Map
from .pipeline.options import ScanSpec
from .pipeline.report import Report
from .result import Call, Failure, Result

#: The classes whose results have a schema; a document's ``kind`` says which it is.
RESULTS: tuple[type[Result], ...] = (
    *(Report, Info, Check, FrameTree, Lookup, Difference, GoldenReport, ExportReport, Map, BatchReport, Failure),
)

#: The heading of the section of a docstring that describes attributes.
_ATTRIBUTES = f"Attributes\n{'-' * len('Attributes')}\n"

#: What all results have, and its descriptions.
_COMMON = ("exit_status", "errors", "warnings", "notes", "damage")

_PLAIN: dict[Any, str] = {str: "string", int: "integer", bool: "boolean", NoneType: "null", Path: "string"}
_TEXT: dict[str, Any] = {"type": "string"}
_OBJECT: dict[str, Any] = {"type": "object"}
_TEXTS: dict[str, Any] = {"type": "object", "additionalProperties": {"type": "string"}}


def _object(properties: dict[str, Any], **optional: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "required": list(properties),
        "additionalProperties": False,
        "properties": properties | optional,
    }


#: Classes that describe themselves as JSON with a method.
_OWN: dict[type, dict[str, Any]] = {
    Pc2ScanError: _object(
        {
            "kind": {"description": "The name of its class.", **_TEXT},
            "message": _TEXT,
            "path": {"type": ["string", "null"]},
            "topic": {"type": ["string", "null"]},
            "stamp_ns": {"type": ["integer", "null"]},
            "hint": {"description": "What the user can do about it.", "type": ["string", "null"]},
            "exit_status": {"type": "integer"},
        },
        traceback={"description": "Of an error that is not expected.", **_TEXT},
    ),
    PointCounts: {
        "description": "Points: all, those used, and those rejected for each reason.",
        "type": "object",
        "additionalProperties": {"type": "integer"},
    },
    ScanSpec: _object(
        {
            "name": {"description": "Its name in a scans file; empty without one.", **_TEXT},
            "params": {"description": "The projection's parameters; infinities and NaN are text.", **_OBJECT},
            "param_origins": {"description": "Where each value comes from.", **_TEXTS},
            "filters": {"description": "What selected points, in order.", "type": "array", "items": _OBJECT},
        }
    ),
    Call: _object(
        {
            "command": _TEXT,
            "sources": {"type": "array", "items": _TEXT},
            "options": {"description": "By name.", **_OBJECT},
            "reasons": {"description": "Why options are there, by name.", **_OBJECT},
        }
    ),
}


class _Definitions:
    """Collects the schemas of classes."""

    def __init__(self) -> None:
        self.found: dict[str, Any] = {}

    def reference(self, cls: type) -> dict[str, Any]:
        """Return a reference to the schema of a class, which is made at the first time."""
        name = cls.kind if issubclass(cls, Result) else cls.__name__
        if name not in self.found:
            self.found[name] = {}
            self.found[name] = _OWN[cls] if cls in _OWN else self._of_class(cls)
        return {"$ref": f"#/$defs/{name}"}

    def _of_class(self, cls: type) -> dict[str, Any]:
        own = getattr(cls, "json_names", ()) or tuple(_types(cls))
        names = [name for name in own if not name.startswith("_")]
        properties: dict[str, Any] = {}
        if issubclass(cls, Result):
            names = [*_COMMON, *(name for name in names if name not in _COMMON)]
            properties["pc2scan"] = {"description": "The version of pc2scan.", **_TEXT}
            properties["kind"] = {"enum": [cls.kind]}
        texts = _descriptions(cls)
        for name in names:
            described = {"description": texts[name]} if name in texts else {}
            properties[name] = described | self.of(_type_of(cls, name))
        return _object(properties)

    def of(self, kind: Any) -> dict[str, Any]:
        """Return the schema of the values of a type."""
        origin, arguments = get_origin(kind), get_args(kind)
        if kind in _PLAIN:
            return {"type": _PLAIN[kind]}
        if kind is float:
            # Infinities and NaN are text.
            return {"type": ["number", "string"]}
        if origin is Literal:
            return {"enum": list(arguments)}
        if origin in (Union, UnionType):
            options = [self.of(each) for each in arguments]
            plain = [each["type"] for each in options if each.keys() == {"type"}]
            if len(plain) == len(options):
                return {"type": [name for each in plain for name in ([each] if isinstance(each, str) else each)]}
            return {"anyOf": options}
        container = origin or kind
        if isinstance(container, type) and issubclass(container, abc.Mapping):
            return {"type": "object", "additionalProperties": self.of((*arguments, int)[1]) if arguments else {}}
        if origin and issubclass(origin, abc.Iterable):
            (each,) = (
                {argument: None for argument in arguments if argument is not ...} if len(arguments) < 3 else (Any,)
            )
            return {"type": "array", "items": self.of(each)}
        if isinstance(kind, type) and issubclass(kind, Enum):
            return {"enum": [member.value for member in kind]}
        if isinstance(kind, type) and (kind in _OWN or is_dataclass(kind) or hasattr(kind, "_fields")):
            return self.reference(kind)
        return {}


def _types(cls: type) -> dict[str, Any]:
    """Return the types of a class's fields; names are also found that are imported for type checkers only."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        if not (is_dataclass(base) or hasattr(base, "_fields")):
            continue
        known = _names(_home(base))
        own = {each.name for each in fields(base)} if is_dataclass(base) else set(base._fields)
        for name, text in inspect.get_annotations(base).items():
            if name in own:
                found[name] = _evaluated(text, known)
    return {name: kind for name, kind in found.items() if get_origin(kind) is not ClassVar}


def _type_of(cls: type, name: str) -> Any:
    """Return the type of an attribute: a field, a property or a constant of the class."""
    types = _types(cls)
    if name in types:
        return types[name]
    attribute = inspect.getattr_static(cls, name, None)
    if isinstance(attribute, property) and attribute.fget is not None:
        text = inspect.get_annotations(attribute.fget)["return"]
        return _evaluated(text, _names(attribute.fget.__module__))
    owner = next(base for base in cls.__mro__ if name in inspect.get_annotations(base))
    text = inspect.get_annotations(owner)[name]
    kind = _evaluated(text, _names(_home(owner)))
    return get_args(kind)[0] if get_origin(kind) is ClassVar else kind


def _home(cls: type) -> str:
    """Return the name of a class's module; public classes say that it is the package."""
    return str(cls.__init__.__globals__["__name__"]) if is_dataclass(cls) else cls.__module__


def _evaluated(annotation: Any, known: dict[str, Any]) -> Any:
    """Return the type that an annotation means."""
    text = annotation.__forward_arg__ if isinstance(annotation, ForwardRef) else annotation
    return eval(text, known) if isinstance(text, str) else text  # noqa: S307  # our own source


def _names(module: str) -> dict[str, Any]:
    """Return the names that a module's annotations may use."""
    known = dict(vars(sys.modules[module]))
    for node in ast.parse(Path(str(known["__file__"])).read_text("utf-8")).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            exec(compile(ast.Module(node.body, []), module, "exec"), known)  # noqa: S102  # our own imports
    return known


def _descriptions(cls: type) -> dict[str, str]:
    """Return the descriptions of attributes: those of the docstring's section, and the docstrings of properties."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        text = inspect.cleandoc(base.__doc__ or "")
        _, _, section = text.partition(_ATTRIBUTES)
        section = re.split(r"\n\n\w+\n-+\n", section)[0]
        for heading, described in re.findall(r"^(\w[\w, ]*)\n((?:(?:    .*)?\n?)+)", section, re.MULTILINE):
            for name in heading.split(","):
                found[name.strip()] = " ".join(described.split())
        for name, attribute in vars(base).items():
            if isinstance(attribute, property) and attribute.__doc__:
                found.setdefault(name, attribute.__doc__.partition("\n")[0])
    return found


def results_schema() -> dict[str, Any]:
    """Return the JSON schema of all results."""
    definitions = _Definitions()
    options = [definitions.reference(cls) for cls in RESULTS]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "results.schema.json",
        "title": "Results of pc2scan as JSON",
        "anyOf": options,
        "$defs": definitions.found,
    }


if __name__ == "__main__":
    Path(__file__).with_name("results.schema.json").write_text(json.dumps(results_schema(), indent=2) + "\n", "utf-8")
