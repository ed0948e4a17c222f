"""A map: its cells, the robot's path, and the scans that are in it or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.arguments import path_of
from pc2scan.core.occupancy import FREE, OCCUPIED, Occupancy
from pc2scan.files.text_output import files_output
from pc2scan.text import Shown, duration, json_value, listed

from .map_files import image_of, map_paths, picture_of, yaml_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.text import Table

#: How many reasons for skipping, and damaged places, are shown as text.
_MAX_SHOWN = 5


@dataclass(frozen=True, slots=True)
class NotDrawn:
    """Messages of a topic that are not in the map, for one reason."""

    topic: str
    reason: str
    count: int

    def __str__(self) -> str:
        return f"{self.count:,} of {self.topic}: {self.reason}"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Map(Shown):
    """A map of a recording by its recorded odometry. Notebooks show its picture.

    Attributes
    ----------
    cells
        (H, W) int8 as in nav_msgs/OccupancyGrid: -1 unknown, 0 free, 100 occupied; the first row has the smallest y.
    resolution
        The side of a cell, metres.
    origin
        x, y (metres) and yaw of the corner of the first cell; yaw is always 0.
    frame
        The frame of the map.
    robot_frame
        The frame whose path is `trajectory`.
    trajectory
        (N, 2) float64, metres: the position of the robot at each scan.
    scans
        How many scans of each topic are in the map.
    converted
        Whether the scans were made of clouds.
    skipped
        The scans that are not in the map, and why.
    notes
        Warnings about the map.
    damage
        The damage in the parts of the recording that were read.
    """

    cells: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]
    frame: str
    robot_frame: str
    trajectory: NDArray[np.float64]
    duration: float
    scans: dict[str, int]
    converted: bool
    skipped: tuple[NotDrawn, ...]
    notes: tuple[str, ...]
    damage: tuple[Damage, ...]

    @property
    def exit_status(self) -> int:
        """The exit status of the command: 0, or 3 if scans were skipped or the recording is damaged."""
        return 3 if self.skipped or self.damage else 0

    @property
    def distance(self) -> float:
        """The length of the robot's path, metres."""
        steps = np.diff(self.trajectory, axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    @property
    def png(self) -> bytes:
        """The picture: the map, the robot's path, a scale, and the axes of the map's frame."""
        occupancy = Occupancy(self.cells, self.resolution, *self.origin[:2])
        return picture_of(occupancy, self.trajectory)

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, destination: str | Path, *, overwrite: bool = False) -> Path:
        """Write the map, as map_server reads it: ``NAME.yaml``, ``NAME.pgm``, and the picture ``NAME.png``.

        Raises
        ------
        DestinationError, UsageError
            If there is such a file, or the name does not end in ``.yaml``.
        OutputError
            If one cannot be written.
        """
        path = path_of("destination", destination)
        with files_output(map_paths(path), overwrite=overwrite) as deliver:
            deliver(contents_of(self, path))
        return path

    def as_dict(self) -> dict[str, Any]:
        """Return JSON's types."""
        height, width = self.cells.shape
        return {
            "exit_status": self.exit_status,
            "preview": "by recorded odometry, no SLAM",
            "frame": self.frame,
            "robot_frame": self.robot_frame,
            "resolution": self.resolution,
            "origin": list(self.origin),
            "width": width,
            "height": height,
            "occupied": self._share(OCCUPIED),
            "free": self._share(FREE),
            "scans": self.scans,
            "converted": self.converted,
            "distance": json_value(self.distance),
            "duration": self.duration,
            "skipped": [{"topic": s.topic, "reason": s.reason, "count": s.count} for s in self.skipped],
            "notes": list(self.notes),
            "damage": [place.as_dict() for place in self.damage],
        }

    def _share(self, value: int) -> float:
        return float(np.count_nonzero(self.cells == value) / self.cells.size)

    def __repr__(self) -> str:
        height, width = self.cells.shape
        return f"<pc2scan.Map of {width} x {height} cells of {self.resolution:g} m in {self.frame!r}>"

    def lines(self) -> Iterator[str]:
        """Yield the text about the map, without skipped scans and damage."""
        height, width = self.cells.shape
        yield (
            f"map: {width:,} x {height:,} cells of {self.resolution:g} m "
            f"({width * self.resolution:.1f} x {height * self.resolution:.1f} m), "
            f"{self._share(OCCUPIED):.1%} occupied, {self._share(FREE):.1%} free"
        )
        of = ", ".join(f"{count:,} of {topic}" for topic, count in self.scans.items())
        yield f"scans: {of}{' (made of clouds)' if self.converted else ''}"
        yield f"robot: {self.robot_frame} drove {self.distance:.1f} m in {self.frame}, in {duration(self.duration)}"
        yield "This is a preview by the recorded odometry: no SLAM, nothing is matched or corrected."

    def _shown(self) -> Iterator[str | Table]:
        yield from self.lines()
        yield from listed([str(each) for each in self.skipped], "skipped", _MAX_SHOWN)
        yield from listed([str(place) for place in self.damage], "damaged", _MAX_SHOWN)
        yield from (f"warning: {note}" for note in self.notes)


def contents_of(made: Map, path: Path) -> list[bytes]:
    """Return the contents of a map's files, `pc2scan.look.map_files.map_paths`."""
    image = image_of(made.cells, made.resolution)
    return [image, made.png, yaml_of(map_paths(path)[0].name, made.resolution, made.origin)]
