"""Options that several commands take, and that belong to no group."""

from typing import Annotated

import typer

__all__ = ["Json", "Moments"]

Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Moments = Annotated[
    list[str],
    typer.Option(
        "--at",
        metavar="TIME",
        help="Show the first cloud at or after this time (see convert --start). Repeatable.",
    ),
]
