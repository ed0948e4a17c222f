"""Recordings of plausible mistakes that would give plausible, wrong results, and of their sound twins."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import Rigid
from support import ROOT
from support.command import run
from support.worlds.mounted import PLACES, cloud, mounted, write_clouds
from support.worlds.moving import BEGIN_NS, Drive, Lidar, write_imu
from support.worlds.weaving import REAR, RINGS, Fault, Weaving, Winding, write_weaving

if TYPE_CHECKING:
    from collections.abc import Callable

FLAT = Lidar(kind="flat", topic="/scan", columns=720)
SOUND = Fault()
SWAPPED = Fault(pair=("base_link", "odom"))


def hall(
    path: Path,
    roll: float = 0.0,
    *,
    mount: tuple[float, float, float] | None = None,
    turned: float = 0.0,
    scale: float = 1.0,
    frame: str = "lidar",
    sensor: str = "32 rings",
    zeros: bool = False,
) -> None:
    """Three clouds of a lidar 0.6 m above the floor of a hall; ``mount`` is recorded, and turned by a roll."""
    clouds = [cloud(PLACES["hall"], sensor, mounted(roll, 0.0), 0.6, stand) * np.float32(scale) for stand in range(3)]
    if zeros:
        for points in clouds:
            points[::50] = 0
    rigid = Rigid.from_rpy(turned, 0.0, 0.0, mount) if mount else None
    tf = [("base_link", frame, BEGIN_NS, *rigid.pose)] if rigid is not None else []
    write_clouds(path, clouds, frame=frame, tf=tf)


def drive(
    path: Path,
    fault: Fault = SOUND,
    moving: Drive | None = None,
    *,
    clock: float | None = None,
    ahead: float = 0.0,
    lidar: Lidar = RINGS,
    names: Callable[[str], str] = str,
) -> None:
    """Three seconds of a robot that weaves; its lidar's clock is ahead, a second lidar's by ``clock`` seconds."""
    lidars = [replace(lidar, clock=ahead), *([] if clock is None else [replace(REAR, clock=clock)])]
    write_weaving(path, lidars, fault, moving or Weaving(), frames=names)


def tilting(path: Path, *, vibration: float) -> None:
    """A robot that rolls and pitches, with an IMU, in a file beside it."""
    moving = Weaving(tilt=math.radians(3.0))
    mount = Rigid.from_rpy(0.0, 0.0, 0.2, (0.0, 0.0, 0.2))
    write_imu(path.with_name("imu.mcap"), moving, mount, 3.0, vibration=vibration)
    write_weaving(path, [RINGS], drive=moving)


def pointer(path: Path) -> None:
    """A Git LFS pointer in place of a recording."""
    path.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{64 * 'a'}\nsize 12345\n")


def scans_only(path: Path) -> None:
    """A recording with 2D scans and no clouds."""
    assert run("convert", ROOT / "fixtures" / "hall.bag", "-o", path, "--min-height", "-0.3").status == 0


def plain(path: Path) -> None:
    """The hall, uncompressed: of a cut chunk there is what comes before the cut."""
    source = ROOT / "fixtures" / f"hall{path.suffix}"
    assert run("repair", source, "-o", path, "--compression", "none").status == 0


def once(make: Callable[..., None], *args: object, **options: object) -> Callable[[Path], object]:
    """Make a recording once in a process, and write it wherever it is asked for."""

    @cache
    def content() -> bytes:
        with TemporaryDirectory() as folder:
            make(Path(folder, "made.mcap"), *args, **options)
            return Path(folder, "made.mcap").read_bytes()

    return lambda path: path.write_bytes(content())


MISTAKES: dict[str, Callable[[Path], object]] = {
    "level.mcap": once(hall),
    "mount_off.mcap": once(hall, mount=(0.2, 0, 0.6), turned=0.087),
    "mounted.mcap": once(hall, mount=(0.2, 0, 0.6)),
    "tilted.mcap": once(hall, 20),
    "slanted.mcap": once(hall, 65),
    "on_side.mcap": once(hall, 90, mount=(0, 0, 0.6)),
    "on_side_and_said.mcap": once(hall, 90, mount=(0, 0, 0.6), turned=math.pi / 2),
    "upside_down.mcap": once(hall, 180, sensor="16 rings"),
    "upside_down_and_unsaid.mcap": once(hall, 180, sensor="128 rings"),
    "upright.mcap": once(hall, sensor="16 rings"),
    "upside_down_and_said.mcap": once(hall, 180, sensor="128 rings", mount=(0, 0, 0.6), turned=math.pi),
    "upright_and_said.mcap": once(hall, sensor="128 rings", mount=(0, 0, 0.6)),
    "in_map.mcap": once(hall, frame="map"),
    "weaving.mcap": once(drive),
    "lidar_front.mcap": once(hall, frame="lidar_front"),
    "millimetres.mcap": once(hall, scale=1000),
    "mounted_in_millimetres.mcap": once(hall, scale=1000, mount=(0.2, 0, 0.6)),
    "microseconds.mcap": once(drive, lidar=replace(RINGS, time_scale=1e-3)),
    "points_clock.mcap": once(drive, lidar=replace(RINGS, points_clock=37.0)),
    "points_timed.mcap": once(drive, lidar=replace(RINGS, points_clock=0.0)),
    "no_unit.mcap": once(drive, lidar=replace(RINGS, time_scale=1e-4)),
    "scanner_in_ms.mcap": once(drive, lidar=replace(FLAT, time_scale=1e-3)),
    "scanner.mcap": once(drive, lidar=FLAT),
    "ceiling.mcap": once(hall, sensor="128 rings"),
    "zeros.mcap": once(hall, zeros=True),
    "jitter.mcap": once(drive, Fault(metres=0.1, degrees=1.0), Drive(turn=0.0)),
    "smooth.mcap": once(drive, Fault(metres=0.002, degrees=0.03), Drive(turn=0.0)),
    "inverted.mcap": once(drive, Fault(inverted=True), Winding()),
    "winding.mcap": once(drive, moving=Winding()),
    "swapped.mcap": once(drive, SWAPPED, Drive()),
    "swapped_and_inverted.mcap": once(drive, SWAPPED._replace(inverted=True), Drive()),
    "perhaps_swapped.mcap": once(drive, SWAPPED),
    "late.mcap": once(drive, Fault(late=0.06)),
    "longer.mcap": once(drive, Fault(scale=0.97)),
    "vibrating.mcap": partial(tilting, vibration=0.1),
    "tilting.mcap": partial(tilting, vibration=0.002),
    "rear_30_ms.mcap": once(drive, clock=0.03),
    "rear.mcap": once(drive, clock=0.0),
    "rear_apart.mcap": once(drive, clock=0.0, names=lambda name: "rear_mount" if name == "rear" else name),
    "rear_37_s.mcap": once(drive, clock=37.0),
    "namespaced.mcap": once(drive, names="robot1/{}".format),
    "ahead.mcap": once(drive, ahead=1.5),
    "pointer.bag": pointer,
    "uncompressed.bag": plain,
    "uncompressed.mcap": plain,
    "scans_only.mcap": scans_only,
}
