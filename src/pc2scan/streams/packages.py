"""Optional packages, which tables need."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def pandas() -> Any:
    """Return the package pandas; raise an ImportError with what to install if it is missing."""
    return _package("pandas", "to_dataframe")


def xarray() -> Any:
    """Return the package xarray; raise an ImportError with what to install if it is missing."""
    return _package("xarray", "to_xarray")


def _package(name: str, method: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as err:
        if err.name != name:
            raise
        raise ImportError(f"{method}() needs the package {name}: pip install {name}", name=name) from err
