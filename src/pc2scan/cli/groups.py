"""Options in groups: a command takes a few groups, typer gets one parameter for each option.

A group is a dataclass whose fields are options (``Annotated[type, typer.Option(...)]``) or other groups. A command
takes it as one parameter: ``def convert(..., *, output: Output)``. `flat` makes the function that typer reads.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import TYPE_CHECKING, Any, TypeGuard, get_type_hints

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from typing import Self

__all__ = ["Group", "flat"]


@dataclass(frozen=True)
class Group:
    """The base of all groups.

    The annotations of a subclass must be objects, not text: its module does without ``from __future__ import
    annotations``. Reading text would take longer than all else that is done with an option.
    """

    @classmethod
    def parameters(cls) -> Iterable[Parameter]:
        """One keyword-only parameter for each option, those of the groups in it included."""
        for field in fields(cls):
            if _is_group(field.type):
                yield from field.type.parameters()
            else:
                default = field.default if field.default_factory is MISSING else field.default_factory()
                yield Parameter(field.name, Parameter.KEYWORD_ONLY, default=default, annotation=field.type)

    @classmethod
    def gathered(cls, values: Mapping[str, Any]) -> Self:
        """Make the group of the values that were typed; other names in ``values`` are ignored."""
        return cls(
            **{
                field.name: field.type.gathered(values) if _is_group(field.type) else values[field.name]
                for field in fields(cls)
            }
        )


def _is_group(kind: object) -> TypeGuard[type[Group]]:
    return isinstance(kind, type) and issubclass(kind, Group)


def flat(command: Callable[..., None]) -> Callable[..., None]:
    """Return a function that takes an option a parameter, and calls ``command`` with its groups."""
    hints = get_type_hints(command, include_extras=True)
    parameters: list[Parameter] = []
    for parameter in signature(command).parameters.values():
        kind = hints[parameter.name]
        parameters += kind.parameters() if _is_group(kind) else [parameter.replace(annotation=kind)]

    @wraps(command)
    def run(**values: Any) -> None:
        command(
            **{
                name: kind.gathered(values) if _is_group(kind) else values[name]
                for name, kind in hints.items()
                if name != "return"
            }
        )

    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    # All that typer reads is in the signature.
    run.__annotations__ = {}
    return run
