"""The loops over points, compiled or in NumPy: the same functions with the same results.

An installation without a C compiler, from source, does without the compiled ones.
"""

from __future__ import annotations

__all__ = ["COMPILED", "angles", "project"]

try:
    from ._kernel import angles, project

    #: Whether the loops are compiled.
    COMPILED = True
except ImportError:
    from .plain import angles, project

    COMPILED = False
