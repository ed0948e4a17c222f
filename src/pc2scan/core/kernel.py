"""The loops over points and beams, compiled or in NumPy: the same functions with the same results.

An installation from source without a C compiler uses NumPy.
"""

from __future__ import annotations

__all__ = ["COMPILED", "angles", "deskew", "follow", "gather", "nodes", "project", "span", "trace"]

try:
    from ._kernel import angles, deskew, follow, gather, nodes, project, span, trace

    #: Whether the loops are compiled.
    COMPILED = True
except ImportError:
    from .plain import angles, deskew, follow, gather, nodes, project, span, trace

    COMPILED = False
