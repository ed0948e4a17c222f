"""``pc2scan diff``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from . import completion
from .options.junit import JUnitGroup
from .options.single import Json
from .render import print_json, say
from .spelling import as_typed

__all__ = ["diff"]

_RULES = "Tolerances"
_LIBM = "Differences of libm"


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A recording, the reference.")],
    b: Annotated[
        Path | None,
        typer.Argument(metavar="[B]", help="The recording to compare with it. Default: A itself, see --topic."),
    ] = None,
    *,
    topics: Annotated[
        list[str],
        typer.Option(
            "--topic",
            "-t",
            metavar="A[:=B]",
            autocompletion=completion.topics(),
            help="Topic to compare, and its name in B if that differs. Repeatable. "
            "Default: every LaserScan and PointCloud2 topic.",
        ),
    ] = [],  # noqa: B006 - typer reads the default and never hands it out
    all_topics: Annotated[
        bool,
        typer.Option("--all-topics", help="Compare the other topics too: matched by log time, byte for byte."),
    ] = False,
    atol: Annotated[
        list[str],
        typer.Option(
            "--atol",
            metavar="[NAME=]X",
            help="Absolute tolerance of all values, or of ranges, intensities or a field of the clouds. Repeatable.",
            rich_help_panel=_RULES,
        ),
    ] = [],  # noqa: B006
    rtol: Annotated[
        list[str],
        typer.Option(
            "--rtol",
            metavar="[NAME=]X",
            help="Tolerance relative to A's value; the two are added. Repeatable.",
            rich_help_panel=_RULES,
        ),
    ] = [],  # noqa: B006
    allow_beams: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Share of a topic's beams (clouds: points) that may be beyond the tolerance: 0.001 is one in a "
            "thousand.",
            show_default=False,
            rich_help_panel=_RULES,
        ),
    ] = 0.0,
    ignore: Annotated[
        list[str],
        typer.Option(
            "--ignore",
            metavar="NAME",
            help="Do not compare: log_time, seq, frame_id, order, intensities, ranges, angle_min and the other numbers "
            "of a scan, shape, layout, padding, is_dense. Repeatable.",
            rich_help_panel=_RULES,
        ),
    ] = [],  # noqa: B006
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Count the differing beams of scans that another libm explains: exactly, from the clouds of the "
            "scans in A or B or --clouds; or an upper limit, from the scans alone.",
            rich_help_panel=_LIBM,
        ),
    ] = False,
    clouds: Annotated[
        Path | None,
        typer.Option(
            metavar="SRC",
            help="Recording with the clouds of the scans, and the transforms; implies --explain.",
            rich_help_panel=_LIBM,
        ),
    ] = None,
    view: Annotated[
        Path | None,
        typer.Option(
            metavar="PAGE",
            help="Also write an HTML page that shows the scans with most differing beams on top of each other.",
        ),
    ] = None,
    junit: JUnitGroup,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing; only set the exit status.")] = False,
) -> None:
    """Show the differences between two recordings.

    Scans and clouds are compared message by message, matched by their header's stamp: repeated stamps in order,
    messages without a stamp by log time. All bits must be equal unless a tolerance is given. Container, compression
    and ROS version are not compared.

    Exit status: 0 the same, 1 different, 2 not comparable.
    """
    from pc2scan.compare.diff import TopicPair
    from pc2scan.compare.diff import diff as compare
    from pc2scan.compare.rules import Rules, parse_tolerance

    rules = Rules(
        atol=parse_tolerance(atol, "--atol"),
        rtol=parse_tolerance(rtol, "--rtol"),
        allow_beams=allow_beams,
        ignore=frozenset(ignore),
    )
    pairs = [TopicPair.parse(topic) for topic in topics]
    compared = partial(compare, a, b, topics=pairs, all_topics=all_topics, rules=rules)
    if explain or clouds is not None:
        from pc2scan.tf.reading import recorded_transforms

        compared = partial(compared, transforms_of=recorded_transforms, clouds=clouds)
    from .junit_cases import of_diff
    from .progress import progress_bar

    inputs = [path for path in (a, b, clouds) if path is not None]
    with junit.writing("diff", inputs) as write_junit:
        with progress_bar(enabled=not (as_json or quiet)) as progress:
            result = compared(progress=progress)
        write_junit(of_diff(result))
    if view is not None:
        from pc2scan.look.compared import compared_view

        compared_view(a, a if b is None else b, view, topics=pairs, rules=rules, summary=str(result))
    if as_json:
        print_json(result.as_dict())
    elif not quiet:
        for line in str(result).split("\n"):
            say(as_typed(line))
    raise typer.Exit(result.exit_status)
