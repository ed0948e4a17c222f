"""Counts what becomes of each message of a conversion, item by item, in the order of the items."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import MessageError, UnconnectedError
from pc2scan.result import MAX_LISTED, Skipped

from .conversion import ConvertedMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pc2scan.model import StoredChunk

    from .items import Item, OpenRoute
    from .report import TopicReport

#: How many of the first messages must fail before a user is warned.
_LOOKED_AT = 10

#: The destination stores everything.
NOTHING_REFUSED: Mapping[int, MessageError] = {}


class Tally:
    """The counts of a conversion: those of the routes, and those of the entries that the report has for each topic.

    Parameters
    ----------
    routes
        The routes by the id of their connection.
    on_error
        Whether to ``skip`` messages that cannot be converted, or to ``fail``.
    warn
        Called with a warning if no transforms connect any of the first messages with the target frame; None: there is
        no such warning.

    Attributes
    ----------
    skipped
        The first `MAX_LISTED` messages that were not converted.
    failures
        How many messages, or groups, have an error.
    is_connected
        Whether transforms connect at least one message with the target frame, or none are needed. Frames may differ
        from message to message, so that it is certain only after the last one.
    """

    def __init__(
        self, routes: Mapping[int, OpenRoute], on_error: str, warn: Callable[[str], None] | None = None
    ) -> None:
        self.skipped: list[Skipped] = []
        self.failures = 0
        self.is_connected = False
        self._routes = routes
        self._on_error = on_error
        self._warn = warn
        #: Messages that no transforms connect with the target frame, and the first of them.
        self._unconnected = 0
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
            With ``on_error`` ``fail``: the first error.
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
                if result.sample is not None:
                    result.sample.clouds.add(result.sample.sample, result.counts)
                    # Several outputs may have one result.
                    result.sample = None
            elif isinstance(result, MessageError) or number in refused:
                entry.skipped += 1
                failed.append((result if isinstance(result, MessageError) else refused[number], entry))
        if failed:
            self._skip(item, failed)
        is_converted = route.steps and route.outputs[0].report.spec is not None
        if not self.is_connected and is_converted and not item.is_group:
            error = item.failure
            self.is_connected = not isinstance(error, UnconnectedError)
            if isinstance(error, UnconnectedError):
                self._note_unconnected(route.connection.topic, error)

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

    def _note_unconnected(self, topic: str, error: UnconnectedError) -> None:
        """Note a message that no transforms connect with the target frame; warn if they connect none of the first."""
        self._unconnected += 1
        self._first_unconnected = self._first_unconnected or (topic, error)
        if self._unconnected == _LOOKED_AT and self._warn is not None:
            topic, first = self._first_unconnected
            advice = f"; {first.hint}" if first.hint else ""
            self._warn(f"none of the first {_LOOKED_AT} messages can be converted: {topic}: {first.message}{advice}")

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
            if self._on_error == "fail":
                raise error
            if len(self.skipped) < MAX_LISTED:
                found = (topic, item.log_time_ns, error.stamp_ns, error.message, error.hint or "")
                self.skipped.append(Skipped(*found, tuple(filter(None, targets))))
