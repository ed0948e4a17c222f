"""Opens recordings for pictures: as one recording, with all transforms."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.errors import UsageError, stamp_text
from pc2scan.tf.reading import read_transforms

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.options.moment import TimeBound
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.tf.buffer import TransformBuffer


class Opened(NamedTuple):
    """A recording, others that were read for their transforms, and the transforms (None if there are none)."""

    reader: Reader
    others: list[Reader]
    buffer: TransformBuffer | None

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts of the recordings that were read."""
        return tuple(damage for each in (self.reader, *self.others) for damage in each.damage)

    def log_times(self, at: Sequence[TimeBound]) -> list[int]:
        """Return moments as log times.

        Raises
        ------
        UsageError
            If one is after the end of the recording.
        """
        first_ns, last_ns = self.reader.summary.start_ns or 0, self.reader.summary.end_ns
        times = [bound.resolve(first_ns) for bound in at]
        if last_ns is not None and (late := [time for time in times if time > last_ns]):
            raise UsageError(
                f"`at` is {stamp_text(late[0])}, the recording is from {stamp_text(first_ns)} to {stamp_text(last_ns)}",
                path=self.reader.path,
                hint=f"`at=0` to `at={(last_ns - first_ns) / 1e9:.3f}` are in it",
            )
        return times


@contextmanager
def opened(sources: Sequence[Path], options: ConvertOptions) -> Iterator[Opened]:
    """Open recordings as one.

    Raises
    ------
    UsageError
        If transforms are needed, and it is not clear which to use.
    RecordingError
        If one cannot be read.
    """
    with ExitStack() as stack:
        readers = open_recordings(sources, stack, verify=options.verify, strict=options.strict)
        others = open_recordings(options.frames.tf_from, stack, verify=options.verify, strict=options.strict)
        reader = as_one(readers)
        yield Opened(reader, others, _transforms([reader, *others], options))


def title_of(sources: Sequence[Path]) -> str:
    """Return the title of a picture of recordings."""
    return ", ".join(source.name or str(source) for source in sources)


def _transforms(readers: Sequence[Reader], options: ConvertOptions) -> TransformBuffer | None:
    """Return all transforms; None if it is not clear which to use and none are requested."""
    try:
        buffer, _ = read_transforms(readers, options.frames)
    except UsageError:
        if options.scan.needs_transforms:
            raise
        return None
    return buffer
