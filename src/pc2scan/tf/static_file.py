"""Reads a YAML file of static transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pc2scan.errors import Pc2ScanError, UsageError
from pc2scan.files.nearby import missing_hint
from pc2scan.files.source import opened_text
from pc2scan.names import did_you_mean

from .options import StaticTransform, number_in

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["load_static_transforms"]

#: Larger files are refused: a list of static transforms is a page of text.
_MAX_FILE_BYTES = 1_000_000


def load_static_transforms(path: Path) -> tuple[StaticTransform, ...]:
    """Read a YAML list of static transforms.

    Each entry is a text that `StaticTransform.parse` reads, or a mapping of ``parent`` (or ``frame_id``), ``child``
    (or ``child_frame_id``), ``translation: [x, y, z]`` and ``rotation: [qx, qy, qz, qw]`` or
    ``rpy: [roll, pitch, yaw]``; metres and radians, or with a unit (``20cm``, ``90deg``).

    Raises
    ------
    UsageError
        If the file cannot be read, or has anything else in it.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415  # heavy
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise UsageError(
                f"has {path.stat().st_size} bytes; a list of static transforms has at most {_MAX_FILE_BYTES}", path=path
            )
        with opened_text(path) as file:
            document = YAML(typ="safe", pure=True).load(file.read(_MAX_FILE_BYTES))
    except FileNotFoundError as err:
        hint = missing_hint(path, (".yaml", ".yml"))
        raise UsageError("does not exist", path=path, hint=hint) from err
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=path) from err
    except (YAMLError, UnicodeDecodeError, RecursionError) as err:
        raise UsageError(f"is not YAML: {str(err).splitlines()[0]}", path=path) from err
    if not isinstance(document, list):
        raise UsageError("is not a YAML list of static transforms", path=path)
    transforms = []
    for number, entry in enumerate(document, 1):
        try:
            transforms.append(_static_transform(entry))
        except Pc2ScanError as err:
            raise UsageError(f"entry {number}: {err.message}", path=path, hint=err.hint) from err
    return tuple(transforms)


def _static_transform(entry: Any) -> StaticTransform:
    if isinstance(entry, str):
        return StaticTransform.parse(entry)
    if not isinstance(entry, dict):
        raise UsageError(f"{entry!r} is not a transform")
    known = {"parent", "frame_id", "child", "child_frame_id", "translation", "rotation", "rpy"}
    if unknown := entry.keys() - known:
        key = min(map(str, unknown))
        hint = f"{did_you_mean(key, sorted(known))} the keys are {', '.join(sorted(known))}".strip()
        raise UsageError(f"unknown key {key!r}", hint=hint)

    def numbers(key: str, count: int) -> list[float]:
        values = entry.get(key, [0.0] * (count - 1) + [float(count == 4)])
        unit = {"translation": "m", "rpy": "rad"}.get(key, "")
        found = [_read_number(value, unit) for value in values] if isinstance(values, list) else []
        read = [number for number in found if number is not None]
        if len(read) != count or len(found) != count:
            raise UsageError(f"{key} is {values!r}, expected {count} numbers")
        return read

    return StaticTransform.of(
        str(entry.get("parent", entry.get("frame_id", ""))),
        str(entry.get("child", entry.get("child_frame_id", ""))),
        numbers("translation", 3),
        numbers("rpy", 3) if "rpy" in entry else numbers("rotation", 4),
    )


def _read_number(value: Any, unit: str) -> float | None:
    if isinstance(value, str):
        return number_in(value, unit)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
