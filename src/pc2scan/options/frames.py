"""The options about transforms and frames of a call, as one object."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import UsageError
from pc2scan.tf.options import FrameOptions

if TYPE_CHECKING:
    from pc2scan.tf.static import StaticTransform

    from .call import Options

_NAMES = ("static_tf", "static_tf_file", "write_static_tf", "tf_from", "tf_topics", "source_frame")


def frames_of(options: Options) -> FrameOptions:
    """Return the options about transforms and frames.

    Raises
    ------
    UsageError
        If a transform cannot be read, or if there are options besides ``frames``, which has all of them.
    """
    if options.frames is not None:
        if options.given.keys() & set(_NAMES):
            raise UsageError("give frames, or the arguments about frames one by one, not both")
        if not isinstance(options.frames, FrameOptions):
            raise TypeError(f"frames is {type(options.frames).__name__}, it must be FrameOptions")
        return options.frames
    static: tuple[StaticTransform, ...] = ()
    if options.static_tf_file or options.static_tf:
        from pc2scan.tf.static import added_transforms  # noqa: PLC0415  # few conversions add any

        static = added_transforms(options.static_tf_file, options.static_tf)
    return FrameOptions(
        tf_topics=options.tf_topics,
        tf_from=options.tf_from,
        static=static,
        source_frame=options.source_frame,
        write_static=options.write_static_tf,
    )
