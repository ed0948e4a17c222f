"""Lines of the manifest for the steps of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .manifest import Record

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from .plan import Step
    from .work import Result


def refused(step: Step, shown: Callable[[Path], str]) -> Record:
    """Return the line of a recording that is refused; ``shown`` returns a path as users know it."""
    assert step.error is not None
    earlier = step.record.output if step.record is not None else ""
    status = step.error.exit_status
    return _record(
        step,
        shown,
        identity=step.found.identity,
        outcome="failed",
        exit_status=status,
        error=step.error.as_dict(),
        output=earlier,
    )


def recorded(step: Step, result: Result, shown: Callable[[Path], str]) -> Record:
    """Return the line of a recording whose conversion has ended; ``shown`` returns a path as users know it."""
    names = (
        "identity",
        "sha256",
        "outcome",
        "exit_status",
        "error",
        "output_identity",
        "started",
        "seconds",
        "attempts",
    )
    return _record(
        step, shown, **{name: getattr(result, name) for name in names}, output=step.output, report=result.report
    )


def says_the_same(record: Record, other: Record) -> bool:
    """Whether two lines of a recording differ at most in times and attempts."""
    names = ("outcome", "error", "identity", "options", "version", "output", "sources")
    return all(getattr(record, name) == getattr(other, name) for name in names)


def _record(step: Step, shown: Callable[[Path], str], **known: Any) -> Record:
    found, paths = step.found, tuple(map(shown, step.found.paths))
    return Record(key=found.key, sources=paths, container=found.container, options=step.choice.digest, **known)
