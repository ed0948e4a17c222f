"""A map: its cells, the robot's path, and the scans that are in it or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pc2scan.core.occupancy import FREE, OCCUPIED, Occupancy
from pc2scan.files.text_output import files_output
from pc2scan.files.urls import path_of
from pc2scan.result import Part, Remark, Result, skipped_remarks
from pc2scan.text import duration

from .map_files import image_of, map_paths, picture_of, yaml_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.result import Skipped


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Map(Result):
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
        Why scans are not in the map, and how many.
    warnings
        What may be wrong with the map.
    damage
        The damage in the parts of the recording that were read.
    """

    kind: ClassVar[str] = "map"
    json_names: ClassVar[tuple[str, ...]] = (
        *("preview", "frame", "robot_frame", "resolution", "origin", "width", "height", "occupied", "free", "scans"),
        *("converted", "distance", "duration", "skipped", "skipped_count"),
    )

    cells: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]
    frame: str
    robot_frame: str
    trajectory: NDArray[np.float64]
    duration: float
    scans: dict[str, int]
    converted: bool
    skipped: tuple[Skipped, ...] = ()
    warnings: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()

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

        With a name that ends in ``.png``, only the picture is written.

        Raises
        ------
        DestinationError, UsageError
            If there is such a file, or the name ends in neither ``.yaml`` nor ``.png``.
        OutputError
            If one cannot be written.
        """
        path = path_of("destination", destination)
        with files_output(map_paths(path), overwrite=overwrite) as deliver:
            deliver(contents_of(self, path))
        return path

    #: What the map is.
    preview: ClassVar[str] = "by recorded odometry, no SLAM"

    @property
    def width(self) -> int:
        """Cells along x."""
        return int(self.cells.shape[1])

    @property
    def height(self) -> int:
        """Cells along y."""
        return int(self.cells.shape[0])

    @property
    def occupied(self) -> float:
        """The share of occupied cells."""
        return float(np.count_nonzero(self.cells == OCCUPIED) / self.cells.size)

    @property
    def free(self) -> float:
        """The share of free cells."""
        return float(np.count_nonzero(self.cells == FREE) / self.cells.size)

    @property
    def skipped_count(self) -> int:
        """How many scans are not in the map."""
        return sum(entry.messages for entry in self.skipped)

    def __repr__(self) -> str:
        return f"<pc2scan.Map of {self.width} x {self.height} cells of {self.resolution:g} m in {self.frame!r}>"

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the size of the map, its scans, and the robot's way."""
        yield (
            f"map: {self.width:,} x {self.height:,} cells of {self.resolution:g} m "
            f"({self.width * self.resolution:.1f} x {self.height * self.resolution:.1f} m), "
            f"{self.occupied:.1%} occupied, {self.free:.1%} free"
        )
        of = ", ".join(f"{count:,} of {topic}" for topic, count in self.scans.items())
        yield f"scans: {of}{' (made of clouds)' if self.converted else ''}"
        yield f"robot: {self.robot_frame} drove {self.distance:.1f} m in {self.frame}, in {duration(self.duration)}"
        yield "This is a preview by the recorded odometry: no SLAM, nothing is matched or corrected."

    def remarks(self, *, verbose: bool = False) -> Iterator[Remark]:
        """Yield why scans were skipped, damage and warnings."""
        yield from skipped_remarks(self.skipped, self.skipped_count, verbose=verbose)
        yield from self.usual_remarks(verbose=verbose)


def contents_of(made: Map, path: Path) -> list[bytes]:
    """Return the contents of a map's files, `pc2scan.show.map_files.map_paths`."""
    if path.suffix == ".png":
        return [made.png]
    image = image_of(made.cells, made.resolution)
    return [image, made.png, yaml_of(map_paths(path)[0].name, made.resolution, made.origin)]
