"""The frame in which a message is converted, and the transform to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pc2scan.core.rigid import Rigid

    from .buffer import TransformBuffer

__all__ = ["Frames", "Placement"]


class Placement(NamedTuple):
    """The output's ``frame_id``, and the transform to that frame (None if the message stays in its own)."""

    frame_id: str
    target_from_source: Rigid | None


@dataclass(frozen=True, slots=True)
class Frames:
    """The transforms of a conversion.

    Attributes
    ----------
    target_frame
        Empty if every message stays in its own frame.
    source_frame
        See `FrameOptions`.
    buffer
        None where nothing is transformed.
    tolerance_ns
        How far a stamp may be outside the known transforms.
    """

    target_frame: str = ""
    source_frame: str = ""
    buffer: TransformBuffer | None = None
    tolerance_ns: int = 0

    def place(self, frame_id: str, stamp_ns: int) -> Placement:
        """Return the frame and the transform for a message of this frame and stamp.

        Raises
        ------
        TransformError
            If there is no transform to the target frame at the stamp.
        """
        target = self.target_frame
        if not target:
            return Placement(self.source_frame or frame_id, None)
        return Placement(target, self.transform(target, frame_id, stamp_ns))

    def transform(self, target: str, frame_id: str, stamp_ns: int) -> Rigid | None:
        """The transform that takes a message of this frame and stamp to another frame; None where it is the same.

        Raises
        ------
        TransformError
            If there is no transform to that frame at the stamp.
        """
        source = self.source_frame or frame_id
        # Source of the rule: upstream transforms only if the names differ; tf2 strips one leading slash.
        if self.buffer is None or target.removeprefix("/") == source.removeprefix("/"):
            return None
        return self.buffer.lookup(target, source, stamp_ns, self.tolerance_ns)

    def transform_stamp(self, frame_id: str, stamp_ns: int) -> int:
        """Return the stamp of the transform that `place` returns, in nanoseconds.

        That is the message's stamp; for the stamp 0, the time that `place` uses instead.

        Raises
        ------
        TransformError
            As `place` does.
        """
        if stamp_ns or self.buffer is None:
            return stamp_ns
        return self.buffer.latest_common_ns(self.target_frame, self.source_frame or frame_id)
