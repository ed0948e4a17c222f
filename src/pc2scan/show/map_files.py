"""The files of a map: an image and a YAML file as map_server reads them, and a picture with the path and a scale.

Sources of the rules: map_saver and image_loader of ROS 1's map_server, and map_io of nav2_map_server. Both write 254
for free, 0 for occupied and 205 for unknown cells, the first row of the image being that with the largest y, and both
read a pixel by its darkness, ``(255 - pixel) / 255``: occupied above ``occupied_thresh``, free below ``free_thresh``.

205 is a darkness of 0.19608. With ROS 1's ``free_thresh`` of 0.196 it is unknown; with nav2's default of 0.25 unknown
cells come back as free (slam_toolbox issue 587). 0.196 means the same to both.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.occupancy import FREE, OCCUPIED
from pc2scan.errors import UsageError

from .raster import blend, coverage, disc, png, strokes, text_width

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.core.occupancy import Occupancy

_FREE, _OCCUPIED, _UNKNOWN = 254, 0, 205

_UNKNOWN_COLOUR, _FREE_COLOUR, _OCCUPIED_COLOUR = (226, 231, 236), (255, 255, 255), (23, 34, 46)

_INK, _WAY, _LINES, _WHITE = "#17222e", "#d1495b", "#0b6e99", "#ffffff"

#: The axes of a frame, as RViz colours them.
_X_AXIS, _Y_AXIS = "#d62728", "#2ca02c"

#: The longer side of a picture has at least the first number of pixels, unless a cell would have to be larger than the
#: second number for this, and at most the third.
_SMALL, _LARGEST_CELL, _LARGE = 1100, 12, 2200

#: Pixels around the map, and below it for the scale.
_MARGIN, _FOOT = 24, 58

#: Maximum number of points of the robot's path that are drawn.
_MOST_POINTS = 4_000


#: Suffixes that are not a part of a map's name.
_OTHER_SUFFIXES = (".yml", ".pgm", ".jpg", ".svg", ".pdf", ".html", ".txt", ".csv", ".bag", ".mcap")


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
        stem = path.stem if path.suffix in _OTHER_SUFFIXES else path.name
        raise UsageError(
            "is not the name of a map",
            path=path,
            hint=f"maps are NAME.yaml: `destination={stem}.yaml`; a picture is NAME.png",
        )
    try:
        path.name.encode("utf-8")
    except UnicodeEncodeError as err:
        raise UsageError("has a name that is not UTF-8, but names in maps are", path=path) from err
    return [path.with_suffix(".pgm"), path.with_suffix(".png"), path]


def image_of(cells: NDArray[np.int8], resolution: float) -> bytes:
    """Return the image of a map: PGM, binary."""
    pixels = np.full(cells.shape, _UNKNOWN, np.uint8)
    pixels[cells == FREE] = _FREE
    pixels[cells == OCCUPIED] = _OCCUPIED
    height, width = cells.shape
    head = f"P5\n# CREATOR: pc2scan map {resolution:.3f} m/pix\n{width} {height}\n255\n"
    return head.encode("ascii") + pixels[::-1].tobytes()


def yaml_of(image: str, resolution: float, origin: tuple[float, float, float]) -> bytes:
    """Return the YAML file of a map."""
    # A name that YAML would not read as text is quoted like in JSON, which YAML can read.
    name = image if re.fullmatch(r"[A-Za-z_][\w.-]*", image, re.ASCII) else json.dumps(image, ensure_ascii=False)
    numbers = ", ".join(repr(round(number, 6) + 0.0) for number in origin)
    text = f"""\
# A preview by recorded odometry, made by pc2scan map. Not a result of SLAM.
image: {name}
mode: trinary
resolution: {resolution!r}
origin: [{numbers}]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
    return text.encode("utf-8")


def picture_of(occupancy: Occupancy, way: NDArray[np.float64]) -> bytes:
    """Draw a map.

    Parameters
    ----------
    occupancy
        The map.
    way
        (N, 2): where the robot was, metres.

    Returns
    -------
    bytes
        A PNG file.
    """
    cells, enlarged, shrunk = _fit_cells(occupancy.cells)
    height, width = (side * enlarged for side in cells.shape)
    colours = np.array([_UNKNOWN_COLOUR, _FREE_COLOUR, _OCCUPIED_COLOUR], np.uint8)
    numbers = np.where(cells == OCCUPIED, 2, np.where(cells == FREE, 1, 0))[::-1]
    picture = np.full((height + 2 * _MARGIN + _FOOT, max(width, 200) + 2 * _MARGIN, 3), _UNKNOWN_COLOUR, np.uint8)
    if enlarged == 1:
        # Thicker, because a single pixel is hardly visible.
        occupied = numbers == 2
        for there, here in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
            occupied[there] |= occupied[here].copy()
        numbers[occupied] = 2
    large = numbers.repeat(enlarged, axis=0).repeat(enlarged, axis=1)
    picture[_MARGIN : _MARGIN + height, _MARGIN : _MARGIN + width] = colours[large]
    picture[height + 2 * _MARGIN :] = 255
    map_shape = height + 2 * _MARGIN, picture.shape[1]
    per_metre = enlarged / (occupancy.resolution * shrunk)

    def placed(points: NDArray[np.float64]) -> NDArray[np.float64]:
        x = _MARGIN + (points[:, 0] - occupancy.x) * per_metre
        y = _MARGIN + height - (points[:, 1] - occupancy.y) * per_metre
        return np.stack((x, y), 1)

    above = picture[: map_shape[0]]
    scale = _round_length(160 / per_metre)
    _draw_lines(above, placed, scale, per_metre)
    origin = placed(np.zeros((1, 2)))[0]
    if (origin > 0).all() and (origin < map_shape[::-1]).all():
        _draw_axes(above, origin)
    _draw_way(above, placed(way[np.isfinite(way).all(axis=1)]))
    _draw_scale(picture, scale, scale * per_metre)
    return png(picture)


def _fit_cells(cells: NDArray[np.int8]) -> tuple[NDArray[np.int8], int, int]:
    """Return the cells as they are drawn, the pixels per cell, and how many cells were merged into one."""
    longer = max(cells.shape)
    shrunk = math.ceil(longer / _LARGE)
    if shrunk == 1:
        return cells, max(1, min(_LARGEST_CELL, round(_SMALL / longer))), 1
    height, width = (math.ceil(side / shrunk) for side in cells.shape)
    padded = np.full((height * shrunk, width * shrunk), -1, np.int8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    # The largest value of merged cells is drawn, so that thin walls stay visible.
    return padded.reshape(height, shrunk, width, shrunk).max(axis=(1, 3)), 1, shrunk


def _round_length(metres: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... that is not above a length."""
    power = 10.0 ** math.floor(math.log10(metres))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= metres * (1 + 1e-9))


def _draw_lines(picture: NDArray[np.uint8], placed: object, distance: float, per_metre: float) -> None:
    """Draw faint lines at multiples of a distance."""
    assert callable(placed)
    height, width, _ = picture.shape
    covered = np.zeros((height, width), np.float32)
    x, y = placed(np.zeros((1, 2)))[0]
    step = distance * per_metre
    for column in np.arange(x % step, width, step):
        covered[:, int(column)] = 1
    for row in np.arange(y % step, height, step):
        covered[int(row)] = 1
    blend(picture, covered, _LINES, 0.13)


def _draw_axes(picture: NDArray[np.uint8], origin: NDArray[np.float64]) -> None:
    length = 46.0
    shape = picture.shape[:2]
    for colour, name, along, label in (
        (_Y_AXIS, "y", (0.0, -length), (-3.0, -length - 10)),
        (_X_AXIS, "x", (length, 0.0), (length + 8, 4.0)),
    ):
        axis = np.stack((origin, origin + along))
        at = origin + label
        letters = strokes(name, float(at[0]), float(at[1]), 13.0)
        blend(picture, coverage(shape, [axis], 6.5), _WHITE, 0.8)
        blend(picture, coverage(shape, letters, 5.0), _WHITE, 0.8)
        blend(picture, coverage(shape, [axis], 3.2), colour)
        blend(picture, coverage(shape, letters, 1.9), colour)


def _draw_way(picture: NDArray[np.uint8], way: NDArray[np.float64]) -> None:
    """Draw the robot's path: a ring at its beginning, a dot at its end."""
    if not len(way):
        return
    shape = picture.shape[:2]
    line = way[:: math.ceil(len(way) / _MOST_POINTS)]
    line = np.concatenate([line, way[-1:]])
    moved = np.hypot(*np.diff(line, axis=0).T) > 0.3
    line = line[np.concatenate([[True], moved])]
    blend(picture, coverage(shape, [line], 6.0), _WHITE, 0.75)
    blend(picture, coverage(shape, [line], 2.8), _WAY)
    (x, y), (last_x, last_y) = way[0], way[-1]
    for colour, radius in ((_WHITE, 11.5), (_WAY, 10.0), (_WHITE, 7.5)):
        blend(picture, disc(shape, x, y, radius), colour)
    # The dot fits into the ring, so that both are visible if the robot came back.
    for colour, radius in ((_WHITE, 7.0), (_WAY, 5.5)):
        blend(picture, disc(shape, last_x, last_y, radius), colour)


def _draw_scale(picture: NDArray[np.uint8], metres: float, pixels: float) -> None:
    """Draw a scale below the map."""
    shape = picture.shape[:2]
    y, x = shape[0] - _FOOT / 2, float(_MARGIN)
    ends = [np.array([[at, y - 6], [at, y + 6]]) for at in (x, x + pixels)]
    blend(picture, coverage(shape, [np.array([[x, y], [x + pixels, y]]), *ends], 2.4), _INK)
    text = f"{metres:g} m" if metres < 1000 else f"{metres / 1000:g} km"
    at = x + pixels + 14
    if at + text_width(text, 17.0) < shape[1]:
        blend(picture, coverage(shape, strokes(text, at, y + 8.5, 17.0), 2.1), _INK)
