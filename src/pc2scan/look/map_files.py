"""Maps as map_server reads them: an image, and a YAML file that names it.

Sources of the rules: map_saver and image_loader of ROS 1's map_server, and map_io of nav2_map_server. Both write 254
for free, 0 for occupied and 205 for unknown cells, the first row of the image being that with the largest y, and both
read a pixel by its darkness, ``(255 - pixel) / 255``: occupied above ``occupied_thresh``, free below ``free_thresh``.

205 is a darkness of 0.19608. With ROS 1's ``free_thresh`` of 0.196 it is unknown; with nav2's default of 0.25 unknown
cells come back as free (slam_toolbox issue 587). 0.196 means the same to both.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.occupancy import FREE, OCCUPIED
from pc2scan.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_FREE, _OCCUPIED, _UNKNOWN = 254, 0, 205


def map_paths(path: Path) -> list[Path]:
    """Return the files of a map: image, picture, and the YAML file.

    Raises
    ------
    UsageError
        If the last one has another suffix.
    """
    if path.suffix != ".yaml":
        stem = path.stem if path.suffix in (".yml", ".pgm", ".png") else path.name
        raise UsageError("is not the name of a map", path=path, hint=f"maps are NAME.yaml: `destination={stem}.yaml`")
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
