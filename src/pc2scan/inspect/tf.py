"""The frames of a recording: their parents, times and rates."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from pc2scan.bags.opening import open_recordings
from pc2scan.errors import TransformError, stamp_text
from pc2scan.remote.urls import is_url
from pc2scan.text import Shown, Table, count, listed
from pc2scan.tf.options import FrameOptions
from pc2scan.tf.reading import read_transforms

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.core.rigid import Rigid
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.summary import FrameInfo, Tree

#: How many damaged places are shown as text.
_MAX_SHOWN = 5


@dataclass(frozen=True, slots=True, repr=False)
class FrameTree(Shown):
    """The frames of a recording.

    Attributes
    ----------
    frames
        Statistics of each child frame.
    trees
        Connected frames; more than one tree means that some frames are disconnected.
    warnings
        Which transforms cannot be used, and why.
    buffer
        For lookups.
    damage
        The damage in the parts of the recordings that were read.
    """

    frames: tuple[FrameInfo, ...]
    trees: tuple[Tree, ...]
    warnings: tuple[str, ...]
    buffer: TransformBuffer
    damage: tuple[Damage, ...] = ()

    def lookup(self, target: str, source: str, stamp_ns: int = 0) -> Rigid:
        """Return the transform that takes points in the frame ``source`` to the frame ``target``.

        Parameters
        ----------
        target, source
            Frame names.
        stamp_ns
            The time, nanoseconds since 1970. Default: the latest time that all frames on the way have.

        Returns
        -------
        Rigid
            Its ``translation`` (metres), ``quaternion`` (x, y, z, w), ``rpy`` (radians), and ``apply`` for points.

        Raises
        ------
        TransformError
            If a frame is unknown, the two are not connected, or the stamp is outside of what is recorded.
        """
        try:
            return self.buffer.lookup(target, source, stamp_ns)
        except TransformError as err:
            # None means the latest time.
            err.stamp_ns = stamp_ns or None
            raise

    def __repr__(self) -> str:
        return f"<FrameTree of {len(self.frames)} transforms in {len(self.trees)} trees>"

    def _shown(self) -> Iterator[str | Table]:
        for number, tree in enumerate(self.trees, 1):
            several = f"tree {number} of {len(self.trees)}, not connected with the others, " * (len(self.trees) > 1)
            yield f"{several}from {', '.join(tree.roots or tree.frames[:1])}: {len(tree.frames)} frames"
        yield ""
        yield self.table()
        yield from listed([str(place) for place in self.damage], "damaged", _MAX_SHOWN)
        yield from (f"warning: {warning}" for warning in self.warnings)

    def table(self) -> Table:
        """Return a table with a row for each frame that has a parent."""
        return Table(
            ("child", "parent", "kind", "transforms", "Hz", "first", "last", "largest gap"),
            [
                (
                    frame.child,
                    ", ".join(frame.parents),
                    "static" if frame.static else "dynamic",
                    count(frame.transforms),
                    "-" if frame.rate_hz is None else f"{frame.rate_hz:.2f}",
                    stamp_text(frame.first_ns),
                    stamp_text(frame.last_ns),
                    "-"
                    if frame.largest_gap_ns is None or frame.largest_gap_at_ns is None
                    else f"{frame.largest_gap_ns / 1e9:.3f} s after {stamp_text(frame.largest_gap_at_ns)}",
                )
                for frame in self.frames
            ],
            left=("child", "parent", "kind", "largest gap"),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON's types."""
        return {
            "frames": [asdict(frame) for frame in self.frames],
            "trees": [asdict(tree) for tree in self.trees],
            "warnings": list(self.warnings),
            "damage": [damage.as_dict() for damage in self.damage],
        }


def frame_tree(sources: Sequence[Path], options: FrameOptions | None = None) -> FrameTree:
    """Read the transforms of recordings.

    Parameters
    ----------
    sources
        Recordings; their transforms are merged.
    options
        Topics, further recordings and added transforms.

    Raises
    ------
    RecordingError
        If a source cannot be read.
    UsageError
        If several namespaces have transforms and none was given.
    """
    options = options or FrameOptions()
    read = [*sources, *options.tf_from]
    if any(map(is_url, read)):
        from pc2scan.remote.ranges import stand_ins  # noqa: PLC0415  # loads fsspec

        with stand_ins(read) as near:
            found: FrameTree = near.names.of(frame_tree(near.paths, replace(options, tf_from=())))
        return found
    with ExitStack() as stack:
        readers = open_recordings(read, stack)
        buffer, warnings = read_transforms(readers, options)
        damage = tuple(damage for reader in readers for damage in reader.damage)
    return FrameTree(buffer.infos, buffer.trees, tuple(warnings), buffer, damage)
