"""The version of pc2scan, where every layer may read it; imports nothing."""

from __future__ import annotations

__all__ = ["__version__"]

__version__ = "0.1.0"
