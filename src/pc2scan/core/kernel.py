"""The loops over points and beams, compiled or in NumPy: the same functions with the same results.

An installation without a C compiler, from source, does without the compiled ones.
"""

from __future__ import annotations

__all__ = ["COMPILED", "angles", "deskew", "gather", "project", "trace"]

try:
    from ._kernel import angles, deskew, gather, project, trace

    #: Whether the loops are compiled.
    COMPILED = True
except ImportError:
    from .plain import angles, deskew, gather, project, trace

    COMPILED = False
