"""Converts values for JSON, which has neither infinity nor NaN. Imports nothing of pc2scan."""

from __future__ import annotations

import math
from typing import Any

__all__ = ["json_value"]


def json_value(value: Any) -> Any:
    """Return a value with infinities and NaNs as text, in lists and dictionaries too.

    Tuples become lists, named tuples dictionaries.

    >>> json_value({"range_max": float("inf"), "angles": (0.5, float("nan"))})
    {'range_max': 'inf', 'angles': [0.5, 'nan']}
    """
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: json_value(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(part) for part in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
