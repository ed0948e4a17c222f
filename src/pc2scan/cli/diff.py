"""``pc2scan diff``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pc2scan.options.call import Options

from .render import print_json, say
from .spelling import as_typed


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A recording, the reference.")],
    b: Annotated[
        Path | None,
        typer.Argument(metavar="[B]", help="The recording to compare with it. Default: A itself, see --topic."),
    ] = None,
    *,
    options: Options,
) -> None:
    """Show the differences between two recordings.

    Scans and clouds are compared message by message, matched by their header's stamp: repeated stamps in order,
    messages without a stamp by log time. All bits must be equal unless a tolerance is given. Container, compression
    and ROS version are not compared.

    Exit status: 0 the same, 1 different, 2 not comparable.
    """
    from pc2scan.compare.diff import TopicPair
    from pc2scan.compare.diff import diff as compare
    from pc2scan.compare.rules import Rules

    from .junit_cases import junit_output, of_diff
    from .progress import progress_bar

    rules = Rules.of(options)
    pairs = [TopicPair.parse(topic) for topic in options.topics]
    with junit_output(options, "diff", [path for path in (a, b) if path is not None]) as write_junit:
        with progress_bar(enabled=not (options.as_json or options.quiet)) as progress:
            result = compare(a, b, topics=pairs, all_topics=options.all_topics, rules=rules, progress=progress)
        write_junit(of_diff(result))
    if options.view is not None:
        from pc2scan.look.comparison import write_comparison

        write_comparison(a, a if b is None else b, options.view, topics=pairs, rules=rules, summary=str(result))
    if options.as_json:
        print_json(result.as_dict())
    elif not options.quiet:
        for line in str(result).split("\n"):
            say(as_typed(line))
    raise typer.Exit(result.exit_status)
