"""Packages with the name of a public function, which is what calling them calls.

``pc2scan.tf`` and ``pc2scan.golden`` are packages. Python sets them as attributes of ``pc2scan`` when anything in them
is imported, so a function of that name would be there or not depending on what was imported before.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from inspect import Signature
    from typing import Any


class _CallablePackage(ModuleType):
    """A package that is called like the function of its name in ``pc2scan.api``."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return _function(self)(*args, **kwargs)

    @property
    def __signature__(self) -> Signature:
        from inspect import signature  # noqa: PLC0415  # only who looks at signatures pays for it

        return signature(_function(self))

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]  # what help() shows
        doc: str | None = _function(self).__doc__
        return doc


def _function(package: ModuleType) -> Any:
    parent, _, name = package.__name__.rpartition(".")
    return getattr(import_module(f"{parent}.api"), name)


def make_callable(name: str) -> None:
    """Make a package callable; to be called in its ``__init__`` with ``__name__``."""
    sys.modules[name].__class__ = _CallablePackage
