"""Options about frames and transforms.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pc2scan.cli import completion
from pc2scan.cli.groups import Group

from . import FRAMES

if TYPE_CHECKING:
    from pc2scan.tf.options import FrameOptions

__all__ = ["FramesGroup", "StaticTf", "TfSources", "TfTopics", "frame_option"]


def frame_option(text: str, *, show_default: bool = False, panel: str | None = None) -> Any:
    """Return an option that takes a frame of the recordings, which the shell offers."""
    return typer.Option(
        metavar="FRAME", help=text, autocompletion=completion.frames, show_default=show_default, rich_help_panel=panel
    )


StaticTf = Annotated[
    list[str],
    typer.Option(
        "--static-tf",
        metavar="TRANSFORM",
        help="Add a transform: 'parent child x y z qx qy qz qw' or 'parent child x y z roll pitch yaw' "
        "(m, rad; or 20cm, 90deg). Replaces the recording's transform to this child. Repeatable.",
        rich_help_panel=FRAMES,
    ),
]
TfTopics = Annotated[
    list[str],
    typer.Option(
        "--tf-topic",
        metavar="TOPIC",
        autocompletion=completion.topics("/TFMessage", "/tfMessage"),
        help="Topic of the transforms, if not /tf and /tf_static. Repeatable.",
        rich_help_panel=FRAMES,
    ),
]


class TfSources(Group):
    """Options about the sources of transforms."""

    tf_from: Annotated[
        list[Path],
        typer.Option(
            "--tf-from",
            metavar="FILE",
            help="Read the transforms of this recording too. Repeatable.",
            rich_help_panel=FRAMES,
        ),
    ]
    tf_topic: TfTopics

    def options(self) -> "FrameOptions":
        """Return the library's options."""
        from pc2scan.tf.options import FrameOptions

        return FrameOptions(tf_topics=tuple(self.tf_topic), tf_from=tuple(self.tf_from))


class FramesGroup(Group):
    """Options about frames and transforms."""

    static_tf: StaticTf
    static_tf_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="A YAML list of transforms like those of --static-tf.", rich_help_panel=FRAMES
        ),
    ] = None
    write_static_tf: Annotated[
        bool,
        typer.Option(
            "--write-static-tf",
            help="Write the added transforms to DST's /tf_static.",
            rich_help_panel=FRAMES,
        ),
    ] = False
    transforms: TfSources
    source_frame: Annotated[
        str,
        frame_option("Frame of the messages to convert, if their frame_id is wrong or empty.", panel=FRAMES),
    ] = ""
