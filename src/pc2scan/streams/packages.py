"""Packages that pc2scan does without: tables need them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__all__ = ["pandas", "xarray"]


def pandas() -> Any:
    """The package pandas; an ImportError that says what to do if it is not installed."""
    return _package("pandas", "to_dataframe")


def xarray() -> Any:
    """The package xarray; an ImportError that says what to do if it is not installed."""
    return _package("xarray", "to_xarray")


def _package(name: str, method: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as err:
        if err.name != name:
            raise
        raise ImportError(f"{method}() needs the package {name}: pip install {name}", name=name) from err
