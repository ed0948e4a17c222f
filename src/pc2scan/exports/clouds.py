"""The formats of clouds: a function each, which writes the clouds of a topic into a new folder."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import ExitStack, contextmanager
from typing import IO, TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import IDENTITY_POSE
from pc2scan.errors import UnwritableError, stamp_text

from .scans import lines_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from pc2scan.streams.clouds import Cloud

    from .poses import Posed
    from .scans import Write

_WORD = re.compile(r"[!-~]+")

#: Fields with the strength of a return, the best one first.
_INTENSITIES = ("intensity", "intensities", "i", "reflectivity", "reflectance")


@contextmanager
def write_pcd(path: Path) -> Iterator[Write]:
    """Write a binary .pcd for each cloud, named after its stamp in nanoseconds, with its own fields.

    Source of the rules: "The PCD (Point Cloud Data) file format", version 0.7, of PCL's documentation.
    """
    path.mkdir()
    stamps: Counter[int] = Counter()

    def write(cloud: Cloud, posed: Posed | None) -> None:
        points = cloud.points()
        names = points.dtype.names or ()
        if odd := [name for name in names if name == "_" or not _WORD.fullmatch(name)]:
            raise UnwritableError(f"a field is named {odd[0]!r:.60}: names in a .pcd file are words of ASCII")
        fields = [points.dtype[name] for name in names]
        x, y, z, i, j, k, r = IDENTITY_POSE if posed is None else posed.sensor().pose
        lines: dict[str, Iterable[object]] = {
            "VERSION": ["0.7"],
            "FIELDS": names,
            "SIZE": [field.base.itemsize for field in fields],
            "TYPE": [field.base.kind.upper() for field in fields],
            "COUNT": [field.shape[0] if field.shape else 1 for field in fields],
            "WIDTH": [cloud.shape[1]],
            "HEIGHT": [cloud.shape[0]],
            "VIEWPOINT": [f"{value:.17g}" for value in (x, y, z, r, i, j, k)],
            "POINTS": [len(points)],
            "DATA": ["binary"],
        }
        header = "".join(f"{key} {' '.join(map(str, values))}\n" for key, values in lines.items())
        number = stamps[cloud.stamp_ns]
        stamps[cloud.stamp_ns] += 1
        name = f"{cloud.stamp_ns}_{number}.pcd" if number else f"{cloud.stamp_ns}.pcd"
        (path / name).write_bytes(header.encode() + points.tobytes())

    yield write


@contextmanager
def write_kitti(path: Path) -> Iterator[Write]:
    """Write KITTI's .bin files: x, y, z and intensity of each point as float32, and nothing else.

    Files are numbered as in KITTI's odometry benchmark; ``times.txt`` has seconds from the first cloud on,
    ``stamps.txt`` nanoseconds since 1970, ``poses.txt`` the first three rows of each pose's matrix.
    """
    path.mkdir()
    stamps: list[int] = []
    with ExitStack() as stack:
        lists: dict[str, IO[str]] = {}

        def write(cloud: Cloud, posed: Posed | None) -> None:
            name = next((each for each in _INTENSITIES if each in cloud.fields), None)
            if name is None:
                raise UnwritableError(
                    f"the cloud has no field with intensities: its fields are {', '.join(cloud.fields) or 'none'}",
                    hint="`format=pcd` can hold any fields",
                )
            lines = {"stamps.txt": str(cloud.stamp_ns)}
            if posed is not None:
                sensor = posed.sensor()
                matrix = np.column_stack([sensor.matrix, sensor.translation])
                lines["poses.txt"] = " ".join(map(repr, matrix.ravel().tolist()))
            with np.errstate(all="ignore"):
                xyz = cloud.xyz().astype("<f4")
                points = np.column_stack([xyz, cloud[name].astype("<f4")])
            # Points with a NaN or an infinite coordinate are not returns.
            (path / f"{len(stamps):06d}.bin").write_bytes(points[np.isfinite(xyz).all(axis=1)].tobytes())
            stamps.append(cloud.stamp_ns)
            lines["times.txt"] = stamp_text(cloud.stamp_ns - stamps[0])
            for file, text in lines.items():
                if file not in lists:
                    lists[file] = stack.enter_context(lines_file(path / file))
                lists[file].write(f"{text}\n")

        yield write
