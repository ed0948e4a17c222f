"""A map: its cells, the robot's path, the scans that are in it or not, and its files.

Sources of the rules: map_saver and image_loader of ROS 1's map_server, and map_io of nav2_map_server. Both write 254
for free, 0 for occupied and 205 for unknown cells, the first row of the image being that with the largest y, and both
read a pixel by its darkness, ``(255 - pixel) / 255``: occupied above ``occupied_thresh``, free below ``free_thresh``.

205 is a darkness of 0.19608. With ROS 1's ``free_thresh`` of 0.196 it is unknown; with nav2's default of 0.25 unknown
cells come back as free (slam_toolbox issue 587). 0.196 means the same to both.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pc2scan.core.occupancy import FREE, OCCUPIED, UNSEEN
from pc2scan.errors import UsageError
from pc2scan.files.outputs import files_output
from pc2scan.files.urls import path_of
from pc2scan.result import Part, Remark, Result, skipped_remarks
from pc2scan.text import duration

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.result import Skipped

#: What a pixel of the picture is, and its colour. The axes have the colours of RViz.
_UNKNOWN, _FREE, _LINE, _X_AXIS, _Y_AXIS, _OCCUPIED, _PATH = range(7)
_COLOURS = bytes.fromhex("e2e7ec ffffff cbdfe8 d62728 2ca02c 17222e d1495b")

#: The longer side of a picture has about as many pixels, unless a cell would be larger than the second number for this.
_SIDE, _LARGEST_CELL = 1600, 12

#: Pixels from the centre to the rim of a point of the path, and of the dot at its end.
_POINT, _END = 3, 9


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
    duration
        The time from the first position to the last, seconds.
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

    #: What the map is.
    preview: ClassVar[str] = "by recorded odometry, no SLAM"

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
        return float(np.mean(self.cells == OCCUPIED))

    @property
    def free(self) -> float:
        """The share of free cells."""
        return float(np.mean(self.cells == FREE))

    @property
    def skipped_count(self) -> int:
        """How many scans are not in the map."""
        return sum(entry.messages for entry in self.skipped)

    @property
    def png(self) -> bytes:
        """The picture: the map, the robot's path with a dot at its end, the axes of its frame, and lines for scale."""
        merged = math.ceil(max(self.cells.shape) / _SIDE)
        height, width = (math.ceil(side / merged) for side in self.cells.shape)
        cells = np.full((height * merged, width * merged), UNSEEN, np.int8)
        cells[: self.height, : self.width] = self.cells
        # The largest value of merged cells is drawn, so that thin walls stay visible.
        cells = cells.reshape(height, merged, width, merged).max(axis=(1, 3))
        enlarged = max(1, min(_LARGEST_CELL, _SIDE // max(height, width)))
        pixels = np.select([cells == OCCUPIED, cells == FREE], [_OCCUPIED, _FREE], _UNKNOWN).astype(np.uint8)
        pixels = pixels.repeat(enlarged, axis=0).repeat(enlarged, axis=1)
        scale = enlarged / (self.resolution * merged)
        for rows, first, axis in ((pixels.T, self.origin[0], _Y_AXIS), (pixels, self.origin[1], _X_AXIS)):
            between = self._between_lines
            for number in range(math.ceil(first / between), math.ceil((first + len(rows) / scale) / between)):
                line = rows[min(int((number * between - first) * scale), len(rows) - 1)]
                line[line < _OCCUPIED] = _LINE if number else axis
        path = (self.trajectory - self.origin[:2]) * scale
        _dot(pixels, path, _POINT)
        _dot(pixels, path[-1:], _END)
        return _png(pixels[::-1])

    @property
    def _between_lines(self) -> float:
        """How far the lines of the picture are apart, metres: 1, 2, 5, ...; at most a quarter of its side."""
        quarter = max(self.cells.shape) * self.resolution / 4
        power = 10.0 ** math.floor(math.log10(quarter))
        return max(factor * power for factor in (1, 2, 5) if factor * power <= quarter)

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
            deliver(self.contents(path))
        return path

    def contents(self, path: Path) -> list[bytes]:
        """Return the contents of the map's files, those of `map_paths`."""
        image, *others = map_paths(path)
        return [self._pgm(), self.png, self._yaml(image.name)] if others else [self.png]

    def _pgm(self) -> bytes:
        pixels = np.select([self.cells == OCCUPIED, self.cells == FREE], [0, 254], 205).astype(np.uint8)
        head = f"P5\n# CREATOR: pc2scan map {self.resolution:.3f} m/pix\n{self.width} {self.height}\n255\n"
        return head.encode("ascii") + pixels[::-1].tobytes()

    def _yaml(self, image: str) -> bytes:
        # YAML reads JSON's quotes. A name that is not UTF-8 keeps its bytes.
        text = f"""\
# A preview by recorded odometry, made by pc2scan map. Not a result of SLAM.
image: {json.dumps(image, ensure_ascii=False)}
mode: trinary
resolution: {self.resolution!r}
origin: {[round(number, 6) + 0.0 for number in self.origin]}
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
        return text.encode("utf-8", "surrogateescape")

    def __repr__(self) -> str:
        return f"<pc2scan.Map of {self.width} x {self.height} cells of {self.resolution:g} m in {self.frame!r}>"

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the size of the map, its scans, and the robot's way."""
        yield (
            f"map: {self.width:,} x {self.height:,} cells of {self.resolution:g} m "
            f"({self.width * self.resolution:.1f} x {self.height * self.resolution:.1f} m), "
            f"{self.occupied:.1%} occupied, {self.free:.1%} free; lines are {self._between_lines:g} m apart"
        )
        of = ", ".join(f"{count:,} of {topic}" for topic, count in self.scans.items())
        yield f"scans: {of}{' (made of clouds)' if self.converted else ''}"
        yield f"robot: {self.robot_frame} drove {self.distance:.1f} m in {self.frame}, in {duration(self.duration)}"
        yield "This is a preview by the recorded odometry: no SLAM, nothing is matched or corrected."

    def remarks(self, *, verbose: bool = False) -> Iterator[Remark]:
        """Yield why scans were skipped, damage and warnings."""
        yield from skipped_remarks(self.skipped, self.skipped_count, verbose=verbose)
        yield from self.usual_remarks(verbose=verbose)


def map_paths(path: Path) -> list[Path]:
    """Return the files of a map: image, picture, and the YAML file; of ``NAME.png`` only the picture.

    Raises
    ------
    UsageError
        If it has another suffix.
    """
    if path.suffix == ".png":
        return [path]
    if path.suffix != ".yaml":
        hint = f"maps are NAME.yaml: `destination={path.stem}.yaml`; a picture is NAME.png"
        raise UsageError("is not the name of a map", path=path, hint=hint)
    return [path.with_suffix(".pgm"), path.with_suffix(".png"), path]


def _dot(pixels: NDArray[np.uint8], places: NDArray[np.float64], radius: int) -> None:
    """Draw dots at places, columns and rows; those outside of the picture are not drawn."""
    size = np.array(pixels.shape[::-1])
    places = np.unique(places[((places >= 0) & (places < size)).all(axis=1)].astype(int), axis=0)
    offsets = np.argwhere(np.hypot(*np.indices((2 * radius + 1,) * 2) - radius) <= radius + 0.5) - radius
    columns, rows = np.clip(places[:, np.newaxis] + offsets, 0, size - 1).reshape(-1, 2).T
    pixels[rows, columns] = _PATH


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """Return pixels as a PNG file."""
    height, width = pixels.shape
    # Each row begins with the number of its filter: 0, none.
    rows = np.pad(pixels, ((0, 0), (1, 0)))
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)),
        (b"PLTE", _COLOURS),
        (b"IDAT", zlib.compress(rows.tobytes(), 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
