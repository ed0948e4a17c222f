"""What a conversion yields: items; and their counts."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import MessageError, TransformError, UnconnectedError
from pc2scan.result import MAX_LISTED, Skipped

from .steps import ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.model import Buffer, StoredChunk

    from .combine.conversion import Contribution
    from .plan import Output, Route
    from .report import TopicReport


#: The destination stores everything.
NOTHING_REFUSED: Mapping[int, MessageError] = {}


class Item(NamedTuple):
    """What a message became, or what a group of messages became together.

    Attributes
    ----------
    route
        The route of the message; of a group, that of its leading message.
    log_time_ns, publish_time_ns, sequence
        Of the message. A group has the log time of the message that completes it, and the leading one's sequence.
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

    route: Route
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    results: Sequence[tuple[Output, ConvertedMessage | Contribution | MessageError]] = ()
    passing: Buffer | None = None
    error: MessageError | None = None
    is_group: bool = False

    @property
    def size(self) -> int:
        """The size of what was made, in bytes."""
        results = (result for output, result in self.results if not (output.used or isinstance(result, MessageError)))
        return len(self.passing or b"") + sum(result.size for result in results)

    @property
    def errors(self) -> Sequence[MessageError]:
        """Why results are missing; each error once."""
        return list({each.message: each for _, each in self.results if isinstance(each, MessageError)}.values())

    @property
    def failure(self) -> MessageError | None:
        """The error of a message without any result; None if it has one."""
        errors = [result for _, result in self.results if isinstance(result, MessageError)]
        return errors[0] if errors and len(errors) == len(self.results) else self.error


class Tally:
    """The counts of a conversion: those of the routes, and those of the entries that the report has for each topic.

    Parameters
    ----------
    routes
        The routes by the id of their connection.
    strict
        Whether a message that cannot be converted is an error; otherwise it is skipped.

    Attributes
    ----------
    skipped
        The first `MAX_LISTED` messages that were not converted; the last of them is the one that is farthest from any
        transform, if that came later.
    failures
        How many messages, or groups, have an error.
    is_connected
        Whether transforms connect at least one message with the target frame, or none are needed. Frames may differ
        from message to message, so that it is certain only after the last one.
    """

    def __init__(self, routes: Mapping[int, Route], *, strict: bool) -> None:
        self.skipped: list[Skipped] = []
        self.failures = 0
        self._farthest_ns = 0
        self.is_connected = False
        self._routes = routes
        self._strict = strict
        self._first_unconnected: tuple[str, UnconnectedError] | None = None

    @property
    def messages(self) -> int:
        """How many messages were read, of all topics that are not skipped."""
        return sum(route.messages for route in self._routes.values())

    def count(self, item: Item, refused: Mapping[int, MessageError] = NOTHING_REFUSED) -> None:
        """Count an item.

        Parameters
        ----------
        refused
            Why the destination cannot store a result, by the number of its output among the item's results; -1 is the
            message as it passes.

        Raises
        ------
        MessageError
            With ``strict``: the first error.
        """
        route = item.route
        failed: list[tuple[MessageError, TopicReport]] = []
        if not item.is_group:
            if not route.writes:
                for entry in route.reports:
                    entry.skip(1)
                return
            route.messages += 1
            if route.report is not None:
                error = item.error or refused.get(-1)
                route.report.messages_in += 1
                if error is None:
                    route.report.messages_out += 1
                else:
                    route.report.skipped += 1
                    failed.append((error, route.report))
        for number, (output, result) in enumerate(item.results):
            entry = output.report
            entry.messages_in += not item.is_group
            if isinstance(result, ConvertedMessage) and number not in refused:
                entry.messages_out += 1
                if not output.used:
                    if output.first is None:
                        output.first = result.message
                    entry.count(result)
                    if result.stamp_ns is not None:
                        entry.stamps.add(result.stamp_ns, item.log_time_ns)
            elif isinstance(result, MessageError) or number in refused:
                entry.skipped += 1
                failed.append((result if isinstance(result, MessageError) else refused[number], entry))
        if failed:
            self._skip(item, failed)
        if not (self.is_connected or item.is_group) and route.outputs and route.outputs[0].spec is not None:
            error = item.failure
            self.is_connected = not isinstance(error, UnconnectedError)
            if self._first_unconnected is None and isinstance(error, UnconnectedError):
                self._first_unconnected = route.connection.topic, error

    def count_chunk(self, chunk: StoredChunk) -> None:
        """Count the messages of a chunk that passes as a whole."""
        for connection_id, entries in chunk.index.items():
            route = self._routes[connection_id]
            route.messages += len(entries)
            (entry,) = route.reports
            entry.messages_in += len(entries)
            entry.messages_out += len(entries)

    def finish(self) -> None:
        """Raise if no message could be converted because no transforms connect any with the target frame.

        Raises
        ------
        TransformError
            The first error.
        """
        if not self.is_connected and self._first_unconnected is not None:
            topic, first = self._first_unconnected
            raise UnconnectedError(f"nothing can be converted: {first.message}", topic=topic, hint=first.hint)

    def _skip(self, item: Item, failed: Sequence[tuple[MessageError, TopicReport]]) -> None:
        """List the errors of an item, or raise the first one."""
        topic = item.route.connection.topic
        self.failures += 1
        # Equal errors are listed once, with all topics that miss the message.
        errors: dict[str, tuple[MessageError, list[str]]] = {}
        for error, entry in failed:
            errors.setdefault(error.message, (error, []))[1].append(entry.target or "")
        for error, targets in errors.values():
            error.topic = topic
            if self._strict:
                raise error
            gap_ns = error.gap_ns if isinstance(error, TransformError) else 0
            if len(self.skipped) >= MAX_LISTED:
                if gap_ns <= self._farthest_ns:
                    continue
                del self.skipped[-1]
            self._farthest_ns = max(self._farthest_ns, gap_ns)
            fields = (topic, item.log_time_ns, error.stamp_ns, error.message, error.hint or "")
            self.skipped.append(Skipped(*fields, tuple(filter(None, targets)), gap_ns=gap_ns))
