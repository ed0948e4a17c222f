"""The arguments of a lookup."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Query:
    """The names and numbers of two frames, the stamp, and the tolerance."""

    target: str
    source: str
    target_number: int
    source_number: int
    stamp_ns: int
    tolerance_ns: int
