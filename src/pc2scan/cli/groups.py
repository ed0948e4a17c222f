"""Groups of options: a command takes a few groups, and Typer gets one parameter for each option.

The attributes of a group are options (``Annotated[type, typer.Option(...)]``) or other groups. A command takes it as
one parameter: ``def convert(..., *, output: Output)``. `flat` makes the function that typer reads.
"""

from __future__ import annotations

from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeGuard, get_args, get_origin

from typer.models import ParameterInfo, TyperPath

from pc2scan.arguments import local_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from typing_extensions import Self

__all__ = ["Group", "PathType", "flat"]


class PathType(TyperPath):
    """The type of options that are paths: a ``file:`` URL is read before Path joins its slashes."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Convert what was typed."""
        return super().convert(local_path(value) if isinstance(value, str) else value, param, ctx)


class Group(SimpleNamespace):
    """The base of all groups. The values of the class are the defaults; the default of a list is the empty list.

    The annotations must be objects, not text, so the module of a group has no ``from __future__ import annotations``.
    To read text would take longer than everything else that is done with an option, and to make dataclasses even
    longer.
    """

    @classmethod
    def parameters(cls) -> Iterable[Parameter]:
        """Return a keyword-only parameter for each option, including those of nested groups."""
        for name, kind in cls.__annotations__.items():
            if _is_group(kind):
                yield from kind.parameters()
            else:
                nothing: Any = [] if get_origin(get_args(kind)[0]) is list else Parameter.empty
                yield Parameter(name, Parameter.KEYWORD_ONLY, default=getattr(cls, name, nothing), annotation=kind)

    @classmethod
    def gathered(cls, values: Mapping[str, Any]) -> Self:
        """Make the group from the typed values; other names in ``values`` are ignored."""
        kinds = cls.__annotations__.items()
        return cls(**{name: kind.gathered(values) if _is_group(kind) else values[name] for name, kind in kinds})


def _read_urls(annotation: Any) -> None:
    """Let an option whose values are paths take ``file:`` URLs."""
    kind, *further = get_args(annotation) or (annotation,)
    if Path in (kind, *get_args(kind)):
        for info in further:
            if isinstance(info, ParameterInfo) and info.click_type is None:
                info.click_type = PathType()


def _is_group(kind: object) -> TypeGuard[type[Group]]:
    return isinstance(kind, type) and issubclass(kind, Group)


def flat(command: Callable[..., None]) -> Callable[..., None]:
    """Return a function with one parameter for each option, which calls ``command`` with its groups."""
    # Not typing.get_type_hints: up to Python 3.10 it makes parameters optional whose default is None.
    taken = signature(command, eval_str=True).parameters
    parameters: list[Parameter] = []
    for parameter in taken.values():
        kind = parameter.annotation
        parameters += kind.parameters() if _is_group(kind) else [parameter]
    for parameter in parameters:
        _read_urls(parameter.annotation)

    @wraps(command)
    def run(**values: Any) -> None:
        command(
            **{
                name: kind.gathered(values) if _is_group(kind := parameter.annotation) else values[name]
                for name, parameter in taken.items()
            }
        )

    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    # Typer reads only the signature.
    run.__annotations__ = {}
    return run
