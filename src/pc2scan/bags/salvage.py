"""The messages of a damaged chunk: those in front of the damage, and those that its index has behind it."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, NamedTuple

from .loading import LazyItems

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Sequence

    from pc2scan.model import Buffer, RawMessage

    from .chunks import Segment


class Salvage(NamedTuple):
    """How the records of a container's chunk are read, each at its place.

    Attributes
    ----------
    end_of
        Returns where the record that begins at a place ends; None if none begins there, or it reaches beyond the data.
    head_of
        Returns the connection's id and the log time of the message at a place; None if none is there.
    message_at
        Returns the message between two places; None if its connection is unknown.
    """

    end_of: Callable[[int], int | None]
    head_of: Callable[[int], tuple[int, int] | None]
    message_at: Callable[[int, int], RawMessage]

    def records(self, data: Buffer, places: Sequence[int], *, complete: bool) -> Iterator[tuple[int, int]]:
        """Yield where records begin and end: one behind the other; behind damage, from the next place on.

        A message with a wrong length ends where the next one begins; the last one ends with the data, if these are
        ``complete``.

        Parameters
        ----------
        data
            The records of a chunk.
        places
            Where messages begin by the chunk's index, sorted.
        complete
            Whether these are all of its bytes.
        """
        position = number = 0
        while position < len(data):
            while number < len(places) and places[number] <= position:
                number += 1
            following = places[number] if number < len(places) else len(data)
            stop = self.end_of(position)
            if stop is None or stop > following:
                stop = following
                if self.head_of(position) is None or (stop == len(data) and not complete):
                    position = stop
                    continue
            yield position, stop
            position = stop

    def messages(
        self, data: Buffer, segment: Segment, known: Container[int], entries: Sequence[tuple[int, int]] | None
    ) -> tuple[LazyItems[RawMessage], dict[str, int | None]]:
        """Return the messages of a damaged chunk, and what is lost: bytes, messages, and between which log times.

        A log time outside of the chunk's is replaced by that in the index, if the index is right about others.

        Parameters
        ----------
        data
            Its records, as far as they could be decompressed.
        segment
            The chunk.
        known
            The connections by id.
        entries
            The log times and the places of its messages in its index; None if it has none.
        """
        expected = {place: time_ns for time_ns, place in entries or ()}
        # If the records are sound, their content is right, whatever the index says.
        places = [] if self._are_sound(data) else sorted(place for place in expected if self.head_of(place))
        starts, stops, replaced = array("Q"), array("Q"), {}
        covered = unknown = confirmed = 0
        for start, stop in self.records(data, places, complete=len(data) >= segment.uncompressed_size):
            covered += stop - start
            head = self.head_of(start)
            if head is None:
                continue
            if head[0] not in known:
                unknown += 1
                continue
            starts.append(start)
            stops.append(stop)
            confirmed += expected.get(start) == head[1]
            if start in expected and not segment.start_ns <= head[1] <= segment.end_ns:
                replaced[start] = expected[start]
        replaced = replaced if len(replaced) <= max(confirmed, 1) else {}

        def make(number: int) -> RawMessage:
            message = self.message_at(starts[number], stops[number])
            return message._replace(log_time_ns=replaced.get(starts[number], message.log_time_ns))

        numbers = array("Q", range(len(starts)))
        times = array("Q", (make(number).log_time_ns for number in numbers))
        lost = len(entries) - confirmed - len(replaced) if entries else unknown or None
        missing = max(segment.uncompressed_size, len(data)) - covered
        # Of a chunk that is cut off, what is lost came behind its last message.
        is_front = len(data) < segment.uncompressed_size and len(stops) > 0 and covered == stops[-1]
        first_ns = max(times) if is_front else segment.start_ns
        found = {"bytes_lost": missing, "messages_lost": lost, "first_ns": first_ns, "last_ns": segment.end_ns}
        return LazyItems(times, numbers, make, len(data)), found

    def _are_sound(self, data: Buffer) -> bool:
        """Whether records follow each other up to the end."""
        position: int | None = 0
        while position is not None and position < len(data):
            position = self.end_of(position)
        return position is not None
