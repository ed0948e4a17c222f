"""All options of a conversion in one group, and their conversion to the library's options.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

import typer

from pc2scan.cli.groups import Group
from pc2scan.cli.render import warn
from pc2scan.errors import UsageError
from pc2scan.text_enum import TextEnum

from . import REVERSE, RUN
from .frames import FramesGroup
from .moving import CombiningGroup, MovingGroup
from .parameters import ParameterOptions, ProjectionGroup
from .selection import PointsGroup, TopicsGroup

if TYPE_CHECKING:
    from pc2scan.pipeline.options import ConvertOptions

__all__ = ["Channel", "ConversionGroup", "ReverseGroup", "RunGroup", "length", "share", "typed_words"]


class Channel(TextEnum):
    """Channels that laser_geometry can add to a cloud."""

    distances = "distances"
    stamps = "stamps"
    viewpoint = "viewpoint"


class ReverseGroup(Group):
    """Options for converting scans to clouds."""

    reverse: Annotated[
        bool,
        typer.Option(
            "--reverse",
            help="Convert LaserScan to PointCloud2, as laserscan_to_pointcloud does.",
            rich_help_panel=REVERSE,
        ),
    ] = False
    channels: Annotated[
        list[Channel],
        typer.Option(
            "--channel",
            metavar="NAME",
            help="Add these fields to the cloud: distances, stamps, viewpoint. Repeatable.",
            rich_help_panel=REVERSE,
        ),
    ]
    range_cutoff: Annotated[
        str | None,
        typer.Option(
            metavar="M",
            help="Use only returns closer than this.  [default: the scan's range_max]",
            rich_help_panel=REVERSE,
        ),
    ] = None


class RunGroup(Group):
    """Options about the run."""

    on_error: Annotated[
        Literal["skip", "fail"],
        typer.Option(
            help="What to do with messages that cannot be converted. skip: count and list them; fail: end the run.",
            rich_help_panel=RUN,
        ),
    ] = "skip"
    fail_on: Annotated[
        Literal["empty", "warning"] | None,
        typer.Option(
            help="Fail and write nothing. empty: if a scan has no return; warning: if there is any warning, skipped "
            "message or damage.",
            rich_help_panel=RUN,
        ),
    ] = None
    min_used: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE",
            help="Fail and write nothing if less than this share of a topic's points is used in its scans: 0.05 or 5%.",
            rich_help_panel=RUN,
        ),
    ] = None
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs",
            "-j",
            min=0,
            metavar="N",
            help="Number of threads, up to 1,024; the output does not depend on it.  [default: number of cores]",
            show_default=False,
            rich_help_panel=RUN,
        ),
    ] = 0
    no_verify: Annotated[
        bool,
        typer.Option(
            "--no-verify",
            help="Do not check the CRCs of an MCAP source. This is faster, but damage may not be detected.",
            rich_help_panel=RUN,
        ),
    ] = False
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Refuse a damaged source. Without this option, everything readable is recovered, the damage is "
            "reported, and the exit status is 3.",
            rich_help_panel=RUN,
        ),
    ] = False


class ConversionGroup(Group):
    """All options that decide what is converted, but not how it is written or reported."""

    topics: TopicsGroup
    projection: ProjectionGroup
    points: PointsGroup
    frames: FramesGroup
    moving: MovingGroup
    combining: CombiningGroup
    reverse: ReverseGroup
    running: RunGroup

    #: The files that `options` read, by option.
    files = MappingProxyType[str, Path]({})

    def options(self, *, ros_distro: str = "") -> "ConvertOptions":
        """Return the library's options; other entries of a parameter file are reported on standard error."""
        from pc2scan.requests import conversion_of

        words, origins = typed_words(self)
        found = conversion_of(words | {"ros_distro": ros_distro}, origins, warn)
        self.files = MappingProxyType(found.files)
        return found.options

    def first_output(self, verb: str) -> "ConvertOptions":
        """Return the library's options with the first output only; ``verb`` says in the warning what it is used for."""
        from pc2scan.requests import first_output

        return first_output(self.options(), verb, warn)

    def read_files(self) -> dict[str, Path]:
        """Return the files other than recordings that the options name, by option."""
        named = {"`params_file`": self.projection.params_file, "`static_tf_file`": self.frames.static_tf_file}
        named["`scans`"] = self.projection.scans
        return {option: path for option, path in named.items() if path is not None} | dict(self.files)


#: Attributes of the groups whose keyword in the library has another name.
_NAMES = {"tf_topic": "tf_topics"}


def typed_words(*groups: Group) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the options that differ from their defaults, as keywords, and where each parameter was typed.

    The keywords are those of `pc2scan.requests.conversion_of`.
    """
    words: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for group in groups:
        if isinstance(group, ParameterOptions):
            words |= {setting.name: setting.value for setting in group.settings}
            origins |= {setting.name: setting.origin for setting in group.settings}
            continue
        for name, kind in type(group).__annotations__.items():
            value = getattr(group, name)
            if isinstance(value, Group):
                inner, from_inner = typed_words(value)
                words |= inner
                origins |= from_inner
            elif value not in _defaults(group, name, kind):
                words[_NAMES.get(name, name)] = _word(name, value)
    if words.pop("no_verify", False):
        words["verify"] = False
    words.pop("ros_args", None)
    return words, origins


def _defaults(group: Group, name: str, kind: object) -> tuple[Any, ...]:
    is_list = get_origin(get_args(kind)[0]) is list
    return ([], ()) if is_list else (getattr(type(group), name, None),)


def _word(name: str, value: Any) -> Any:
    if name == "range_cutoff":
        return length("--range-cutoff", value)
    if name == "min_used":
        return share(value)
    if isinstance(value, list):
        return tuple(each.value if isinstance(each, TextEnum) else each for each in value)
    return value


def length(option: str, text: str) -> float:
    """Read an option's length in metres; raises `UsageError` if it is not one."""
    from pc2scan.core.quantities import EXAMPLES, quantity

    try:
        return float(text)
    except ValueError:
        value = quantity(text, "m")
    if value is None:
        raise UsageError(f"{option}: {text!r} is not a number", hint=EXAMPLES["m"])
    return value


def share(text: str | None) -> float:
    """Read a share: ``0.05`` or ``5%``."""
    if text is None:
        return 0.0
    try:
        return float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
    except ValueError as err:
        raise UsageError(f"`min_used`: {text!r} is not a share", hint="write 0.05 or 5%") from err
