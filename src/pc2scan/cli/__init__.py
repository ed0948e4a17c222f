"""The command line: parse, call one function of the library, render. One module a command."""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the ``pc2scan`` command."""
    import sys

    from .app import application

    application(*sys.argv[1:2])(prog_name="pc2scan")
