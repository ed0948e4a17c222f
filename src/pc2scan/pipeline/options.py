"""The options of a conversion, besides the projection's own parameters."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from pc2scan.errors import UsageError
from pc2scan.files.urls import path_or_url
from pc2scan.tf.options import FrameOptions

from .scan_spec import ScanSpec

if TYPE_CHECKING:
    from pathlib import Path

    from pc2scan.options.moment import TimeBound


def destination_and_folder(text: str | None) -> tuple[Path | None, Path | None]:
    """Return the destination, or the folder to write into if the text ends with a slash or is a dot.

    >>> destination_and_folder("scans/"), destination_and_folder("scans")
    ((None, PosixPath('scans')), (PosixPath('scans'), None))
    """
    if text is None:
        return None, None
    separators = tuple(filter(None, (os.sep, os.altsep)))
    # Not Path.name, which ignores the slash.
    if text.endswith(separators) or os.path.basename(text) in {".", ".."}:  # noqa: PTH119
        return None, path_or_url(text)
    return path_or_url(text), None


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertOptions:
    """The checked options of a conversion: its outputs, and options that apply to all of them.

    Attributes
    ----------
    scans
        The outputs; usually only one.
    frames
        The source of transforms.
    keep_clouds
        Whether the converted messages are written, too.
    only_scans
        Whether only the new messages are written.
    keep, drop
        Topics or globs that choose among the topics that are not converted. ``drop`` has precedence, and also
        excludes a cloud topic that is not requested by name.
    start, end
        The cut, by log time: from ``start`` on, before ``end``.
    on_error
        What to do if a message cannot be converted: ``skip`` or ``fail``.
    ros_distro
        The ROS distribution whose message definitions are used if the recording has none; empty: a default.
    jobs
        Number of threads; 0: one for each processor core.
    verify
        Whether the CRCs of MCAP files are checked. The checksums of lz4 and bz2 always are.
    strict
        Whether damage of a source is an error; otherwise everything readable is recovered, and the report lists the
        damage.
    fail_on
        When the whole run fails and nothing is written: ``empty`` (if a scan has no return), or ``warning`` (also for
        any other warning, skipped message or damage); empty text for neither.
    min_used
        The share of the points of each topic, 0 to 1, that must be in its scans; otherwise the run fails.
    repair
        Convert nothing: all messages are copied, byte for byte.
    """

    scans: tuple[ScanSpec, ...] = (ScanSpec(),)
    frames: FrameOptions = FrameOptions()
    keep_clouds: bool = False
    only_scans: bool = False
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    start: TimeBound | None = None
    end: TimeBound | None = None
    on_error: str = "skip"
    ros_distro: str = ""
    jobs: int = 0
    verify: bool = True
    strict: bool = False
    fail_on: str = ""
    min_used: float = 0.0
    repair: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.min_used <= 1:
            hint = f"{self.min_used:g} % is {self.min_used / 100:g}" if 1 < self.min_used <= 100 else None
            raise UsageError(f"`min_used` is {self.min_used:g}, it must be a share from 0 to 1", hint=hint)
        if self.only_scans and (self.keep or self.keep_clouds):
            raise UsageError("`only_scans` contradicts `keep` and `keep_clouds`")

    @property
    def scan(self) -> ScanSpec:
        """The first output."""
        return self.scans[0]

    @property
    def window(self) -> int | None:
        """How many units may be loaded ahead, the node's ``queue_size``; None: as many as memory allows."""
        return min((spec.params.queue_size for spec in self.scans if spec.params.queue_size), default=None)

    def with_scan(self, **changes: Any) -> ConvertOptions:
        """Return the options with only the first output, changed."""
        return replace(self, scans=(replace(self.scan, **changes),))
