"""Reads the recordings that follow each other in one file as one recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .merged import MergedReader

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .damage import Damage, DamageLog
    from .reader import Reader


class ConcatenatedReader(MergedReader):
    """Reads all recordings of a file as one."""

    def __init__(self, readers: Sequence[Reader], log: DamageLog) -> None:
        super().__init__(readers)
        self._log = log

    @staticmethod
    def _refuse(readers: Sequence[Reader]) -> None:
        """Accept several readers of one file, also with different ROS versions."""

    @property
    def damage(self) -> tuple[Damage, ...]:
        """The damage in the parts, and between them."""
        return (*super().damage, *self._log.found)
