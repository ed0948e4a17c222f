"""Options about transforms and frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pc2scan.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from .static import StaticTransform


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameOptions:
    """The options of a conversion about frames.

    Attributes
    ----------
    tf_topics
        Topics of the transforms; empty means ``/tf`` and ``/tf_static``, or those of the only namespace that has them.
    tf_from
        Further recordings to read transforms from.
    static
        Transforms that are added to the recording's.
    source_frame
        Replaces the ``frame_id`` of the messages to convert, if that is wrong or empty.
    write_static
        Whether to write ``static_tf`` to the destination's ``/tf_static``.
    """

    tf_topics: tuple[str, ...] = ()
    tf_from: tuple[Path, ...] = ()
    static: tuple[StaticTransform, ...] = ()
    source_frame: str = ""
    write_static: bool = False

    def __post_init__(self) -> None:
        if self.write_static and not self.static:
            raise UsageError("there is no added transform to write", hint="give one with `static_tf`")
