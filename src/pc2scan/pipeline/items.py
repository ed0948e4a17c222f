"""What a conversion yields, and where it comes from and goes to: routes, outputs and items."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import MessageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.model import Buffer, Connection

    from .combine.conversion import Contribution
    from .conversion import ConvertedMessage, Step
    from .report import TopicReport


@dataclass(slots=True, eq=False)
class Output:
    """A topic that the converted messages of a route go to.

    ``index`` is the number of its conversion among those of the route. ``used`` is whether its messages are the points
    that give scans their ranges. ``first`` is the first message; all others have the same geometry. ``points`` is the
    output of the points behind scans that are made of several messages. ``handle`` is the writer's in a recording,
    once the topics are declared; -1 if nothing is written, or if another topic leads the scans.
    """

    report: TopicReport
    index: int
    used: bool = False
    first: Any = None
    points: Output | None = None
    handle: int = -1


@dataclass(slots=True, eq=False)
class OpenRoute:
    """What is done with the messages of one connection.

    ``steps`` convert a message, one after the other (see `pc2scan.pipeline.conversion.steps_of`); there are none if it
    is not converted. Results go to ``outputs``, and so does an error. Messages of ``shrinks_from`` bytes and more
    become smaller when they are converted. ``passing_handle`` is the writer's for messages as they are, -1 if they are
    not written; ``reencode`` makes what is written of them, None if that is what was read. ``report`` is the entry of
    messages that are not converted; each output has another one. ``messages`` counts the messages that were read.
    """

    connection: Connection
    report: TopicReport | None = None
    steps: Sequence[Step] = ()
    reencode: Callable[[Buffer], Buffer] | None = None
    outputs: list[Output] = field(default_factory=list)
    passing_handle: int = -1
    shrinks_from: int = sys.maxsize
    messages: int = 0

    @property
    def reports(self) -> Sequence[TopicReport]:
        """The report's entries that count its messages."""
        return [output.report for output in self.outputs] if self.report is None else [self.report]

    @property
    def writes(self) -> bool:
        """Whether something becomes of its messages; otherwise they are only counted."""
        return self.passing_handle >= 0 or bool(self.outputs)


class Item(NamedTuple):
    """What a message became, or what a group of messages became together.

    Attributes
    ----------
    route
        The route of the message; of a group, that of its leading message.
    log_time_ns, publish_time_ns, sequence
        Of the message. A group has the log time of the message that completes it, and the leading one's sequence.
    size_in
        The size of the message in bytes; 0 for a group, whose messages are items of their own.
    results
        Each output with its result, or with the error in its place. The message of an output that makes one scan of
        several waits for its group.
    passing
        The message as it is written to its own topic; None if it is not.
    error
        Why nothing could be made of the message, or why it cannot pass.
    is_group
        Whether it is a group.
    """

    route: OpenRoute
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    size_in: int
    results: Sequence[tuple[Output, ConvertedMessage | Contribution | MessageError]] = ()
    passing: Buffer | None = None
    error: MessageError | None = None
    is_group: bool = False

    @property
    def size(self) -> int:
        """The size of what was made, in bytes."""
        made = (result for output, result in self.results if not (output.used or isinstance(result, MessageError)))
        return len(self.passing or b"") + sum(result.size for result in made)

    @property
    def errors(self) -> Sequence[MessageError]:
        """Why results are missing; each error once."""
        return list({id(each): each for _, each in self.results if isinstance(each, MessageError)}.values())

    @property
    def failure(self) -> MessageError | None:
        """The error of a message without any result; None if it has one."""
        errors = [result for _, result in self.results if isinstance(result, MessageError)]
        return errors[0] if errors and len(errors) == len(self.results) else self.error


class Span(NamedTuple):
    """The cut in log times: ``start_ns <= t < stop_ns`` (None: no limit), and its first time."""

    start_ns: int | None
    stop_ns: int | None
    first_ns: int
