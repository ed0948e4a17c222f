"""Options that have no effect without another one, or together with it: every door refuses by these two tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import UsageError, name_list

from .option import Parameter, Scope
from .processing import CloudCombination, PointSelection, RobotMotion
from .projection import SHARED, Projection
from .table import options_of

if TYPE_CHECKING:
    from collections.abc import Collection

#: An option, the options of which it needs one, and the command in which it needs it; empty: in all commands.
NEEDS = (
    ("node", "params_file", ""),
    ("launch_args", "params_file", ""),
    ("trajectory_frames", "trajectory", ""),
    ("imu", "level", ""),
    ("point_time", "deskew", ""),
    ("stamp", "deskew", ""),
    ("channels", "reverse", ""),
    ("pose_frame", "format", "batch"),
    ("base_frame", "format", "batch"),
    ("base_frame", "pose_frame odom_topic", "export"),
    ("base_frame", "pose_frame odom_topic", "batch"),
    *((name, "init", "golden") for name in ("start", "end", "topics", "params_file")),
)

#: Options about scans.
_OF_SCANS = {
    name for group in (Projection, PointSelection, RobotMotion, CloudCombination) for name in group.__annotations__
}
_OF_SCANS |= {"preset", "keep_used", "min_used"}

#: Options that describe one output, but for parameters of the projection: these override those of a file.
_OF_ONE_OUTPUT = [
    name
    for name, option in options_of("convert").items()
    if option.scope in (Scope.ONE_OUTPUT, Scope.SINGLE) and not isinstance(option, Parameter)
]

#: An option, those that have no effect together with it, and why.
IDLE = (
    ("scans", " ".join(_OF_ONE_OUTPUT), "which has it for each output, or for all of them under 'defaults'"),
    ("params", "preset params_file node", "which has all parameters"),
    ("reverse", " ".join(sorted(_OF_SCANS - SHARED - {"deskew"})), "which makes clouds"),
    ("rebin", "point_time", "which converts scans, whose beams have the times of their time_increment"),
    ("accumulate", "window", "which uses all messages of an interval"),
    ("every", "window", "which uses all messages of an interval"),
    ("only_scans", "keep keep_clouds clouds_as", "which writes nothing else"),
    ("dry_run", "report", "which writes nothing; `as_json` prints it"),
)


def refuse_idle(given: Collection[str], command: str = "") -> None:
    """Raise if an option has no effect.

    Parameters
    ----------
    given
        The names of the options that are given.
    command
        The command or function that they are given to.

    Raises
    ------
    UsageError
        It names the options, and what they need or contradict.
    """
    for name, others, only in NEEDS:
        if name in given and only in ("", command) and not any(other in given for other in others.split()):
            needed = " or ".join(f"`{other}`" for other in others.split())
            raise UsageError(f"`{name}` has no effect without {needed}")
    for other, names, why in IDLE:
        if other in given and (idle := [f"`{name}`" for name in names.split() if name in given]):
            raise UsageError(f"{name_list(idle)} {'have' if idle[1:] else 'has'} no effect with `{other}`, {why}")
