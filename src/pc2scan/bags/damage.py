"""The damage of a recording, reported by the readers that recover the rest."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import DamageError, stamp_text
from pc2scan.text import counted, size

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from pc2scan.errors import TopicError
    from pc2scan.files.source_file import SourceFile

#: The hint for damage that ended a run.
RECOVER = "copy the recording again; without `strict` everything readable in it is recovered"

#: Places that are reported one by one.
MAX_PLACES = 10_000

#: Topics that are listed with wrong counts.
MAX_TOPICS = 5


class Damage(NamedTuple):
    """One damaged place of a source, and the losses there.

    Attributes
    ----------
    what
        What is wrong: observed and allowed.
    path
        The file.
    offset
        Place in the file, bytes (in the decompressed file, if all of it is compressed); None if the damage concerns
        the file as a whole.
    bytes_lost
        Bytes that are missing or in no record, of a chunk uncompressed; 0 if everything was recovered, or if the size
        is unknown.
    messages_lost
        None if unknown.
    first_ns, last_ns
        Log times between which messages may be missing; None if unknown.
    """

    what: str
    path: Path
    offset: int | None = None
    bytes_lost: int = 0
    messages_lost: int | None = None
    first_ns: int | None = None
    last_ns: int | None = None

    @property
    def loses(self) -> bool:
        """Whether anything may be missing."""
        return bool(self.bytes_lost) or self.messages_lost != 0

    def __str__(self) -> str:
        where = f"{self.path}" + ("" if self.offset is None else f", byte {self.offset}")
        lost = "; ".join(filter(None, (self._lost(), self._span())))
        return f"{where}: {self.what}" + (f" ({lost})" if lost else "")

    def _lost(self) -> str:
        parts = [size(self.bytes_lost)] if self.bytes_lost else []
        if self.messages_lost == 0 and not self.bytes_lost:
            return "nothing lost, but what was read there may be wrong"
        if self.messages_lost:
            parts.append(counted(self.messages_lost, "message"))
        return f"{' and '.join(parts)} lost" if parts else ""

    def _span(self) -> str:
        first, last = self.first_ns, self.last_ns
        if first is not None and last is not None:
            return f"log time {stamp_text(first)}" + (f" to {stamp_text(last)}" if last > first else "")
        if first is not None:
            return f"from log time {stamp_text(first)} on"
        return f"before log time {stamp_text(last)}" if last is not None else ""


def count_details(counts: Iterable[tuple[str, int, int]]) -> str:
    """List topics whose number of messages differs from the declared one: name, declared and found number.

    >>> count_details([("/a", 3, 2), ("/b", 1, 1)])
    ' (/a: 3 declared, 2 found)'
    """
    wrong = [f"{topic}: {declared} declared, {read} found" for topic, declared, read in counts if declared != read]
    more = len(wrong) - MAX_TOPICS
    return f" ({'; '.join(wrong[:MAX_TOPICS])}{f'; and {more} more topics' if more > 0 else ''})" if wrong else ""


def mention(damage: Sequence[Damage], err: TopicError) -> None:
    """Let an error about a missing topic say that the recording is damaged, if it is: the topic may be lost."""
    note = f"the recording is damaged, and topics may be missing: {damage[0].path}: {damage[0].what}" if damage else ""
    # One command may open the recording for another, and both say it.
    if note not in (err.hint or ""):
        err.hint = f"{err.hint}; {note}" if err.hint else note


@dataclass(slots=True, eq=False)
class DamageLog:
    """The damage that one reader has found so far.

    A place is noted once, even if it is read again. Several threads may note damage at the same time.

    Parameters
    ----------
    strict
        Whether damage is an error.
    """

    strict: bool = False
    _found: dict[object, Damage] = field(default_factory=dict)
    _path: Path | None = None

    def note(self, error: DamageError, *, key: object = None, **details: Any) -> None:
        """Note damage, or raise it.

        Parameters
        ----------
        error
            The damage and its file.
        key
            Makes the place unique, if the offset does not.
        **details
            Attributes of `Damage` beside ``what`` and ``path``.

        Raises
        ------
        DamageError
            If the log is strict.
        """
        if self.strict:
            raise error
        assert error.path is not None
        damage = Damage(error.message, error.path, **details)  # type: ignore[arg-type]
        place = (damage.path, damage.offset, key)
        if place in self._found or len(self._found) < MAX_PLACES:
            self._found[place] = damage
        else:
            self._found[None] = Damage(f"there is more damage than {MAX_PLACES} places", damage.path)

    def note_message(self, error: DamageError, key: object, time_ns: int, **details: Any) -> None:
        """Note a message that is lost."""
        self.note(error, key=key, messages_lost=1, first_ns=time_ns, last_ns=time_ns, **details)

    def note_index(self, file: SourceFile, offset: int, what: str) -> None:
        """Note, once a file, that its index and its content disagree: the content is right.

        Parameters
        ----------
        offset
            The place of the content. Of several, that nearest to the front is noted, in whatever order they are read.
        what
            What the two say.
        """
        place = (file.path, None, "index")
        known = self._found.get(place)
        if known is None or known.offset is None or offset < known.offset:
            error = DamageError(f"the index and the content disagree: {what}", path=file.path, hint=RECOVER)
            if self.strict:
                raise error
            self._found[place] = Damage(error.message, file.path, offset, messages_lost=0)

    def stand_for(self, path: Path, earlier: DamageLog) -> None:
        """Report what is noted, and what an earlier log has, as damage of this file: it is read from a copy."""
        self._path = path
        self._found = {**earlier._found, **self._found}

    @property
    def places(self) -> tuple[Damage, ...]:
        """All damage in the order of the file, that of the file as a whole first."""
        ordered = sorted(self._found.values(), key=lambda damage: -1 if damage.offset is None else damage.offset)
        return tuple(damage._replace(path=self._path or damage.path) for damage in ordered)
