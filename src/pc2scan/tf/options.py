"""Which transforms count, and in which frame messages are converted: what callers ask for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.errors import ParameterError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pc2scan.core.rigid import Rigid, TransformRow

__all__ = ["FrameOptions", "StaticTransform"]


@dataclass(frozen=True, slots=True)
class StaticTransform:
    """A transform that holds at any time, added by the user.

    Attributes
    ----------
    parent, child
        Frame names.
    parent_from_child
        Where the child is in the parent.
    """

    parent: str
    child: str
    parent_from_child: Rigid

    @classmethod
    def parse(cls, text: str) -> StaticTransform:
        """Read ``parent child x y z qx qy qz qw`` or ``parent child x y z roll pitch yaw`` (metres, radians).

        Raises
        ------
        UsageError
            If it is neither, or the quaternion is zero.
        """
        words = text.replace(",", " ").split()
        usage = "write 'parent child x y z qx qy qz qw' or 'parent child x y z roll pitch yaw' (metres, radians)"
        if len(words) not in (8, 9):
            raise UsageError(f"{text!r} has {len(words)} words, a static transform has 8 or 9", hint=usage)
        try:
            numbers = [float(word) for word in words[2:]]
        except ValueError as err:
            raise UsageError(f"{text!r} is not a static transform: {err}", hint=usage) from err
        return cls.of(words[0], words[1], numbers[:3], numbers[3:])

    @classmethod
    def of(cls, parent: str, child: str, translation: Sequence[float], rotation: Sequence[float]) -> StaticTransform:
        """Take a translation, and a rotation as x, y, z, w or as roll, pitch, yaw.

        Raises
        ------
        UsageError
            If a name is empty, both are the same, or the numbers are no rotation.
        """
        if not parent or not child or parent.removeprefix("/") == child.removeprefix("/"):
            raise UsageError(f"a static transform needs two frames, not {parent!r} and {child!r}")
        from pc2scan.core.rigid import Rigid  # noqa: PLC0415  # only conversions with transforms pay for it

        try:
            rigid = (
                Rigid.from_rpy(rotation[0], rotation[1], rotation[2], translation)
                if len(rotation) == 3
                else Rigid(rotation, translation)  # type: ignore[arg-type]
            )
        except ParameterError as err:
            raise UsageError(f"static transform from {parent} to {child}: {err.message}") from err
        return cls(parent, child, rigid)

    def row(self, stamp_ns: int) -> TransformRow:
        """As the transform of a TFMessage."""
        return (self.parent, self.child, stamp_ns, *self.parent_from_child.pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameOptions:
    """What a conversion is told about frames.

    Attributes
    ----------
    tf_topics
        Where the transforms are; empty means ``/tf`` and ``/tf_static``, or those of the only namespace that has them.
    tf_from
        Further recordings whose transforms count.
    static
        Transforms that the recording lacks.
    source_frame
        Overrides the ``frame_id`` of the messages to convert, where that is wrong or empty.
    write_static
        Whether ``static`` is written to the destination's ``/tf_static``.
    """

    tf_topics: tuple[str, ...] = ()
    tf_from: tuple[Path, ...] = ()
    static: tuple[StaticTransform, ...] = ()
    source_frame: str = ""
    write_static: bool = False

    def __post_init__(self) -> None:
        if self.write_static and not self.static:
            raise UsageError("there is no added transform to write", hint="give one with `static`")
