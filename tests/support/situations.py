"""Plausible mistakes that would give plausible, wrong results: small recordings, and their sound twins.

Each has the commands of a user who makes the mistake, with what must be said, and those of a user who does not, who is
told nothing. ``{src}`` is the recording, ``{out}`` the result.
"""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.rigid import Rigid
from support import ROOT
from support.command import run
from support.worlds.mounted import PLACES, cloud, mounted, write_clouds
from support.worlds.moving import BEGIN_NS, Drive, Lidar, write_imu
from support.worlds.weaving import REAR, RINGS, Fault, Weaving, Winding, write_weaving

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["SITUATIONS", "Situation"]

_SOUND = Fault()


class Situation(NamedTuple):
    """A mistake, and its sound twin.

    Attributes
    ----------
    name
        What is wrong.
    build, commands
        The recording, and commands, each with a part of what it must say.
    sound_build, sound_commands
        The twin; None: the same recording.
    """

    name: str
    build: Callable[[Path], Path]
    commands: tuple[tuple[str, str], ...]
    sound_commands: tuple[str, ...]
    sound_build: Callable[[Path], Path] | None = None


def hall(
    roll: float = 0.0,
    pitch: float = 0.0,
    *,
    mount: tuple[float, float, float] | None = None,
    turned: float = 0.0,
    scale: float = 1.0,
    frame: str = "lidar",
    sensor: str = "32 rings",
    zeros: bool = False,
) -> Callable[[Path], Path]:
    """Three clouds of a lidar 0.6 m above the floor of a hall; ``mount`` is recorded, and turned by a roll."""

    def build(folder: Path) -> Path:
        clouds = [
            cloud(PLACES["hall"], sensor, mounted(roll, pitch), 0.6, stand) * np.float32(scale) for stand in range(3)
        ]
        if zeros:
            for points in clouds:
                points[::50] = 0
        rigid = Rigid.from_rpy(turned, 0.0, 0.0, mount) if mount else None
        tf = [("base_link", frame, BEGIN_NS, *rigid.pose)] if rigid is not None else []
        return write_clouds(folder / "drive.mcap", clouds, frame=frame, tf=tf)

    return build


def drive(
    fault: Fault = _SOUND,
    moving: Drive | None = None,
    *,
    hertz: float = 100.0,
    clock: float | None = None,
    ahead: float = 0.0,
    lidar: Lidar = RINGS,
    names: Callable[[str], str] = str,
) -> Callable[[Path], Path]:
    """Three seconds of a robot that weaves; its lidar's clock is ahead, a second lidar's by ``clock`` seconds."""

    def build(folder: Path) -> Path:
        lidars = [replace(lidar, clock=ahead), *([] if clock is None else [replace(REAR, clock=clock)])]
        return write_weaving(folder / "drive.mcap", lidars, fault, moving or Weaving(), odometry_hz=hertz, frames=names)

    return build


def tilting(*, vibration: float) -> Callable[[Path], Path]:
    """A robot that rolls and pitches, with an IMU, in a file beside it."""

    def build(folder: Path) -> Path:
        moving = Weaving(tilt=math.radians(3.0))
        write_imu(folder / "imu.mcap", moving, Rigid.from_rpy(0.0, 0.0, 0.2, (0.0, 0.0, 0.2)), 3.0, vibration=vibration)
        return write_weaving(folder / "drive.mcap", [RINGS], drive=moving)

    return build


def fixture(name: str) -> Callable[[Path], Path]:
    """A copy of a fixture."""
    return lambda folder: Path(shutil.copy(ROOT / "fixtures" / name, folder / name))


def pointer(folder: Path) -> Path:
    """A Git LFS pointer in place of a recording."""
    path = folder / "drive.bag"
    path.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{64 * 'a'}\nsize 12345\n")
    return path


def scans_only(folder: Path) -> Path:
    """A recording with 2D scans and no clouds."""
    done = run("convert", ROOT / "fixtures" / "hall.bag", "-o", folder / "drive.mcap", "--min-height", "-0.3")
    assert done.status == 0
    return folder / "drive.mcap"


_HEIGHTS = "--min-height -0.4 --max-height 0.9"
_HALL_BAG = "convert {src} -o {out} --min-height -0.5 --max-height 0.9"
_ABOVE = "--min-height 0.1 --max-height 1.5"
_IN_BASE = f"convert {{src}} -o {{out}} --target-frame base_link {_ABOVE}"
_DESKEW = f"{_IN_BASE} --deskew --fixed-frame odom"
_HALL = "convert {src} -o {out}"
_FLAT = Lidar(kind="flat", topic="/scan", columns=720)
_REBIN = "convert {src} -o {out} --rebin --beams 720 --deskew --fixed-frame odom"
_SWAPPED = ("base_link", "odom")
_REAR = 'hint: --static-tf "base_link rear X Y Z ROLL PITCH YAW" says where it is mounted (metres, radians)'
_LEVEL = (
    f"convert {{src}} imu.mcap -o {{out}} --target-frame base_link {_ABOVE} --level --imu /imu "
    '--static-tf "base_link imu_link 0 0 0.2 0 0 0.2"'
)


def _typed(pitch: float) -> str:
    return f"{_IN_BASE} --static-tf 'base_link lidar 0 0 0.6 0 {pitch} 0'"


SITUATIONS = (
    # Mounts and frames.
    Situation(
        "a mount typed 1.5 degrees off",
        hall(),
        (
            (_typed(0.026), "is tilted by 1."),
            (f"{_typed(0.026).replace('convert', 'view').replace('{out}', 'p.html')}", "is tilted by 1."),
        ),
        (_typed(0),),
    ),
    Situation(
        "a mount recorded 5 degrees off",
        hall(mount=(0.2, 0, 0.6), turned=0.087),
        ((_IN_BASE, "is tilted by 5."),),
        (_IN_BASE,),
        hall(mount=(0.2, 0, 0.6)),
    ),
    Situation(
        "a mount typed in degrees",
        hall(),
        ((_typed(20), "0 20deg 0"),),
        (_typed(0),),
    ),
    Situation(
        "a tilted lidar",
        hall(20, 0),
        ((f"{_HALL} {_HEIGHTS}", "is tilted by 20."), ("info {src}", "is tilted by 20.")),
        (f"{_HALL} {_HEIGHTS}",),
        hall(),
    ),
    Situation(
        "a lidar tilted by 65 degrees",
        hall(65, 0),
        (
            (f"{_HALL} {_HEIGHTS}", "is slanted: "),
            ("info {src}", "is slanted: "),
            ("view {src} -o p.html", "is slanted: "),
        ),
        (f"{_HALL} {_HEIGHTS}",),
        hall(),
    ),
    Situation(
        "a lidar on its side, which its transform does not say",
        hall(90, 0, mount=(0, 0, 0.6)),
        (
            (_IN_BASE, "frame 'base_link' is probably on its side, with +y up: no floor is visible"),
            (f"{_HALL} {_HEIGHTS} --overwrite", "frame 'lidar' is probably on its side, with +y up"),
            ("info {src}", '--static-tf "base_link lidar 0 0 0.6 1.5683 -0.0005 0" --target-frame base_link makes it'),
        ),
        (_IN_BASE,),
        hall(90, 0, mount=(0, 0, 0.6), turned=math.pi / 2),
    ),
    Situation(
        "a lidar upside down",
        hall(180, sensor="16 rings"),
        ((f"{_HALL} {_HEIGHTS}", "is upside down"), ("info {src}", "is upside down")),
        (f"{_HALL} --min-height -0.1 --max-height 0.9",),
        hall(sensor="16 rings"),
    ),
    Situation(
        "a lidar upside down between floor and ceiling, which its transform says",
        hall(180, sensor="128 rings", mount=(0, 0, 0.6), turned=math.pi),
        (
            (f"{_HALL} {_HEIGHTS}", "is upside down according to its transform to 'base_link'"),
            (f"{_HALL} {_HEIGHTS} --target-frame lidar --overwrite", "is upside down according to its transform"),
            ("info {src}", "is upside down according to its transform to 'base_link'"),
        ),
        (f"{_HALL} {_HEIGHTS}",),
        hall(sensor="128 rings", mount=(0, 0, 0.6)),
    ),
    Situation(
        "clouds in map, without a target frame",
        hall(frame="map"),
        ((f"{_HALL} {_HEIGHTS}", "the clouds are in 'map'"),),
        (f"{_HALL} {_HEIGHTS}",),
        hall(),
    ),
    Situation(
        "a target frame that the robot moves in",
        drive(),
        (
            (f"{_HALL} {_ABOVE} --target-frame odom", "in which base_link moves"),
            ("info {src} --target-frame odom", "in which base_link moves"),
            ("info {src} --target-frame odom", "--preset slam_toolbox --target-frame base_link"),
        ),
        (_IN_BASE, "info {src} --target-frame base_link"),
    ),
    Situation(
        "a source frame that the robot moves in",
        drive(),
        (
            (f"{_IN_BASE} --source-frame odom", "leave out --source-frame"),
            (
                f"{_HALL} {_ABOVE} --overwrite --source-frame odom",
                "in which lidar, the frame of the clouds, moves with",
            ),
            (f"{_DESKEW} --overwrite --source-frame odom", "leave out --source-frame"),
            (
                f"view {{src}} -o p.html --target-frame base_link {_ABOVE} --source-frame odom",
                "leave out --source-frame",
            ),
            ("info {src} --source-frame odom", "leave out --source-frame"),
        ),
        (_IN_BASE, "info {src}"),
    ),
    Situation(
        "a static transform in the wrong order",
        hall(),
        ((f"{_IN_BASE} --static-tf 'lidar base_link 0 0 0.6 0 0 0'", "the parent comes first"),),
        (_typed(0),),
    ),
    Situation(
        "a static transform of a frame that is misspelt",
        hall(frame="lidar_front"),
        (
            (_typed(0), "has no effect: the clouds are in lidar_front"),
            (_typed(0), 'did you mean --static-tf "base_link lidar_front 0 0 0.6 0 0 0"?'),
        ),
        (_typed(0),),
        hall(),
    ),
    Situation(
        "a static transform in millimetres",
        hall(),
        ((f"{_IN_BASE} --static-tf 'base_link lidar 0 0 600 0 0 0'", "points of the first 3 clouds are used"),),
        (_typed(0),),
    ),
    Situation(
        "a static transform over one that moves",
        drive(),
        ((f"{_DESKEW} --static-tf 'odom base_link 0 0 0 0 0 0'", "which move"),),
        (_DESKEW,),
    ),
    Situation(
        "a misspelt source frame",
        drive(),
        ((f"{_IN_BASE} --source-frame lidr", "did you mean lidar?"),),
        (f"{_IN_BASE}",),
    ),
    # Units and limits.
    Situation(
        "clouds in millimetres",
        hall(scale=1000),
        (
            (_HALL, "in millimetres that is 4.05 m (--cloud-scale 0.001 corrects it), in centimetres 40.5 m"),
            ("info {src}", "--cloud-scale 0.001"),
            ("info {src} --cloud-scale 0.001", "--cloud-scale 0.001 --min-height -0.5 --max-height 0.9"),
        ),
        (f"{_HALL} {_HEIGHTS} --cloud-scale 0.001", f"view {{src}} -o p.html {_HEIGHTS} --cloud-scale 0.001"),
    ),
    Situation(
        "a range in millimetres",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --range-max 30000", "--range-max 30000mm"),),
        (f"{_HALL} {_HEIGHTS} --range-max 30",),
    ),
    Situation(
        "beams from 0 to 360 degrees",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --angle-min 0 --angle-max 360deg", "50% of the beams never have a return"),),
        (f"{_HALL} {_HEIGHTS} --angle-min -180deg --angle-max 180deg",),
    ),
    Situation(
        "angles in degrees",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --angle-min -90 --angle-max 90", "--angle-min -90deg, --angle-max 90deg"),),
        (f"{_HALL} {_HEIGHTS} --angle-min -90deg --angle-max 90deg --geometry centered",),
    ),
    Situation(
        "an increment in degrees",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --angle-increment 0.5", "--angle-increment 0.5deg"),),
        (f"{_HALL} {_HEIGHTS} --angle-increment 0.5deg",),
    ),
    Situation(
        "heights in centimetres",
        hall(),
        ((f"{_HALL} --min-height -40 --max-height 90", "if these are centimetres"),),
        (f"{_HALL} {_HEIGHTS}",),
    ),
    Situation(
        "a tolerance in milliseconds",
        drive(),
        ((f"{_IN_BASE} --transform-tolerance 50", "--transform-tolerance 50ms"),),
        (f"{_IN_BASE} --transform-tolerance 50ms",),
    ),
    Situation(
        "a scan_time in milliseconds twice",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --scan-time 0.1ms", "no lidar is so fast: it is in seconds"),),
        (f"{_HALL} {_HEIGHTS} --scan-time 100ms",),
    ),
    Situation(
        "a time_increment in another unit",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --time-increment 5e-8", "a whole turn takes"),),
        (f"{_HALL} {_HEIGHTS} --time-increment 5e-5", f"{_HALL} {_HEIGHTS} --time-increment -0.00005 --overwrite"),
    ),
    Situation(
        "times of points in microseconds",
        drive(lidar=replace(RINGS, time_scale=1e-3)),
        (
            (_DESKEW, "are taken for ns: a cloud takes 9.98e-05 s, but clouds come every 0.1 s; --point-time t:us"),
            ("info {src}", "--point-time t:us"),
            (
                f"{_IN_BASE} --overwrite --time-increment auto",
                "time_increment is 0, because by the times of points (t) a",
            ),
        ),
        (f"{_DESKEW} --point-time t:us",),
    ),
    Situation(
        "times of points on another clock than their stamps",
        drive(lidar=replace(RINGS, points_clock=37.0)),
        (
            ("info {src}", "measured 37 to 37.1 s after the stamp of their cloud, by field timestamp, but clouds come"),
            ("info {src}", "deskewing moves the points wrongly; --point-time azimuth computes the times of a lidar"),
            (_DESKEW, "from which its points are 37 s away: their clock is another one; --point-time azimuth"),
            (f"{_DESKEW} --point-time azimuth", "hint: if it is the first: --point-time azimuth:0.1:ccw:start"),
        ),
        ("info {src}", _DESKEW),
        drive(lidar=replace(RINGS, points_clock=0.0)),
    ),
    Situation(
        "times of points in no known unit",
        drive(lidar=replace(RINGS, time_scale=1e-4)),
        ((_DESKEW, "are in no unit that fits"), ("info {src}", "are in no unit that fits")),
        (_DESKEW, "info {src}", f"{_IN_BASE} --overwrite --time-increment auto"),
        drive(),
    ),
    Situation(
        "2D scans whose time_increment is in milliseconds",
        drive(lidar=replace(_FLAT, time_scale=1e-3)),
        (
            (_REBIN, "by its time_increment a turn takes 0.0001 s, but scans come every 0.1 s"),
            ("check {src}", "time_increment is in seconds"),
        ),
        (_REBIN,),
        drive(lidar=_FLAT),
    ),
    Situation(
        "a range that ends before the first wall",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --range-max 0.3", "are used; range_min is 0 m and range_max 0.3 m"),),
        (f"{_HALL} {_HEIGHTS} --range-max 12",),
    ),
    Situation(
        "a range that begins behind the walls",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --range-min 30", "are used; range_min is 30 m"),),
        (f"{_HALL} {_HEIGHTS} --range-min 0.3",),
    ),
    Situation(
        "heights above the ceiling",
        hall(),
        ((f"{_HALL} --min-height 4 --max-height 6", "min_height is 4 m"),),
        (f"{_HALL} {_HEIGHTS}",),
    ),
    Situation(
        "the floor within the heights",
        hall(),
        ((f"{_HALL} --min-height -1 --max-height 0.9", "the floor is within the heights"),),
        (f"{_HALL} {_HEIGHTS}",),
    ),
    Situation(
        "the ceiling within the heights",
        hall(sensor="128 rings"),
        (
            (f"{_HALL} --min-height -0.4", "max_height is without limit"),
            (f"{_HALL} --min-height -0.4 --overwrite", "--max-height 2.19 ends below it"),
        ),
        (f"{_HALL} {_HEIGHTS}",),
    ),
    Situation(
        "points at the sensor itself",
        hall(zeros=True),
        ((f"{_HALL} {_HEIGHTS}", "are at (0, 0, 0)"),),
        (f"{_HALL} {_HEIGHTS} --range-min 0.1",),
    ),
    Situation(
        "a mean over near and far",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --reduce mean", "puts returns where nothing is"),),
        (f"{_HALL} {_HEIGHTS} --reduce surface",),
    ),
    # Filters.
    Situation(
        "more points a beam than there are",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --min-points 500", "were removed as sparse"),),
        (f"{_HALL} {_HEIGHTS} --min-points 1",),
    ),
    Situation(
        "a condition that no point meets",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --where 'z > 90'", "100% of all points were"),),
        (f"{_HALL} {_HEIGHTS} --where 'z < 90'",),
    ),
    # Motion.
    Situation(
        "odometry that jitters",
        drive(Fault(metres=0.1, degrees=1.0), Drive(turn=0.0)),
        ((_DESKEW, "the transforms to odom jitter"),),
        (_DESKEW,),
        drive(Fault(metres=0.002, degrees=0.03), Drive(turn=0.0)),
    ),
    Situation(
        "odometry whose poses are inverted",
        drive(Fault(inverted=True), Winding()),
        (
            ("info {src}", "the robot drives sideways, by their inverses straight ahead: the poses are inverted"),
            (_DESKEW, "the poses are inverted"),
        ),
        ("info {src}", _DESKEW),
        drive(_SOUND, Winding()),
    ),
    Situation(
        "odometry whose frames are swapped",
        drive(Fault(pair=_SWAPPED), Drive()),
        (
            (_DESKEW, "the robot drives backwards, by their inverses straight ahead: the two frames are swapped"),
            (f"{_DESKEW} --preset slam_toolbox --range-max 20 --overwrite", "the two frames are swapped"),
            ("check {out} --for slam_toolbox", "map to odom, which then has two parents"),
            ("map {out} -o map.yaml", "the two frames are swapped"),
            ("export {out} -o scans.log --pose-frame odom", "the two frames are swapped"),
            ("info {src}", "the two frames are swapped"),
            # Also if that is why a conversion fails.
            (f"{_DESKEW} --min-used 0.9 --overwrite", "the two frames are swapped"),
        ),
        # Inverted, too, they are right.
        (
            f"{_DESKEW} --range-max 20",
            "map {out} -o map.yaml",
            "export {out} -o scans.log --pose-frame odom",
            "info {src}",
        ),
        drive(Fault(pair=_SWAPPED, inverted=True), Drive()),
    ),
    Situation(
        "odometry that may be the wrong way round",
        drive(Fault(pair=_SWAPPED)),
        (
            (_DESKEW, "if the poses are not inverted, too, the robot moves the wrong way"),
            ("map {out} -o map.yaml", "if the poses are not inverted, too, the robot moves the wrong way"),
        ),
        (_DESKEW, "map {out} -o map.yaml"),
        drive(),
    ),
    Situation(
        "odometry that lags by 60 ms",
        drive(Fault(late=0.06)),
        ((_DESKEW, "of 60 ms later: the odometry lags"),),
        (_DESKEW,),
        drive(Fault(scale=0.97)),
    ),
    Situation(
        "an IMU that vibrates",
        tilting(vibration=0.1),
        ((_LEVEL, "as that of an IMU that vibrates"),),
        (_LEVEL,),
        tilting(vibration=0.002),
    ),
    Situation(
        "a lidar that turns the other way round",
        drive(),
        ((f"{_DESKEW} --point-time azimuth:0.1:cw:start", "--point-time azimuth:0.1:ccw:start"),),
        (f"{_DESKEW} --point-time azimuth:0.1:ccw:start",),
    ),
    Situation(
        "two lidars whose clocks differ by 30 ms",
        drive(clock=0.03),
        ((f"{_DESKEW} --topic /points:=/scan --topic /rear:=/scan", "/rear was measured 30 ms earlier"),),
        (f"{_DESKEW} --topic /points:=/scan --topic /rear:=/scan",),
        drive(clock=0.0),
    ),
    Situation(
        "no transforms for SLAM",
        hall(),
        (("info {src}", "need odometry and the lidar's mount, and the recording has no transforms: --trajectory"),),
        ("info {src}",),
        drive(),
    ),
    Situation(
        "two lidars, one of which has a tree of its own",
        drive(clock=0.0, names=lambda name: "rear_mount" if name == "rear" else name),
        tuple(
            (f"{_IN_BASE} --overwrite --topic /points:=/scan --topic /rear:=/scan{added}", _REAR)
            for added in ("", " --static-tf 'rear_body rear 0 0 0 0 0 0'")
        ),
        (f"{_IN_BASE} --topic /points:=/scan --topic /rear:=/scan",),
        drive(clock=0.0),
    ),
    Situation(
        "two lidars whose clocks differ by 37 s",
        drive(clock=37.0),
        (
            (
                f"{_IN_BASE} --topic /points:=/scan --topic /rear:=/scan",
                "they are of different clocks hint: --time-offset auto measures by how much the clocks differ",
            ),
            (
                f"{_IN_BASE} --topic /points:=/scan --topic /rear:=/scan --time-offset auto",
                "/rear /scan 30 30 - joined",
            ),
        ),
        (f"{_IN_BASE} --topic /points:=/scan --topic /rear:=/scan --time-offset auto",),
    ),
    Situation(
        "a fixed frame that moves with the robot",
        drive(),
        ((f"{_IN_BASE} --deskew --fixed-frame base_link", "--fixed-frame odom is a frame that does not move"),),
        (_DESKEW,),
    ),
    Situation(
        "a recording that is read twice",
        hall(),
        ((f"convert {{src}} {{src}} -o {{out}} {_HEIGHTS}", "twice"),),
        (f"{_HALL} {_HEIGHTS}",),
    ),
    # The cut.
    Situation(
        "a start after the end of the recording",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --start 3600", "the recording"),),
        (f"{_HALL} {_HEIGHTS} --start 0.1",),
    ),
    Situation(
        "a start after the end of the cut",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --start 0.2 --end 0.1", "start is not before end"),),
        (f"{_HALL} {_HEIGHTS} --start 0.1 --end 0.2",),
    ),
    # Scans that consumers cannot place.
    Situation(
        "scans without odometry",
        drive(),
        (
            (f"{_IN_BASE} --preset slam_toolbox --range-max 20 --drop /tf", ""),
            ("check {out} --for slam_toolbox", "cure record the robot's odometry on /tf"),
        ),
        (f"{_IN_BASE} --preset slam_toolbox --range-max 20", "check {out} --for slam_toolbox"),
    ),
    Situation(
        "scans without a mount",
        drive(),
        (
            (f"{_HALL} {_HEIGHTS} --preset slam_toolbox --range-max 20 --drop /tf_static", ""),
            (
                "check {out} --for slam_toolbox",
                'cure for scans made from clouds: pc2scan convert --static-tf "base_link l',
            ),
        ),
        (f"{_HALL} {_HEIGHTS} --preset slam_toolbox --range-max 20", "check {out} --for slam_toolbox"),
    ),
    Situation(
        "transforms in a namespace",
        drive(names=lambda name: f"robot1/{name}"),
        (
            (f"{_HALL} {_HEIGHTS} --preset slam_toolbox --range-max 20", ""),
            ("check {out} --for slam_toolbox", "cure did you mean robot1/lidar?"),
            ("check {out} --for slam_toolbox", "--odom-frame robot1/odom"),
            ("map {out} -o map.yaml", "--odom-frame robot1/odom"),
        ),
        (f"{_HALL} {_HEIGHTS} --preset slam_toolbox --range-max 20", "check {out} --for slam_toolbox"),
        drive(),
    ),
    Situation(
        "an offset of a clock with the wrong sign",
        drive(ahead=1.5),
        (
            (
                f"{_IN_BASE} --time-offset 1.5",
                "takes its stamps farther from those of /tf: without it they are 1.5 s off",
            ),
            (f"{_IN_BASE} --overwrite --time-offset 1.5", "--time-offset /points=auto measures what corrects them"),
        ),
        (f"{_IN_BASE} --time-offset -1.5",),
    ),
    Situation(
        "an offset of a clock that is right",
        drive(),
        ((f"{_IN_BASE} --time-offset -37", "without it they fit, with it they are 37 s off"),),
        (_IN_BASE,),
    ),
    Situation(
        "a map in a frame of the robot",
        drive(),
        (
            (f"{_IN_BASE} --preset slam_toolbox --range-max 20", ""),
            ("map {out} -o map.yaml --odom-frame lidar", "in which base_link does not move"),
            (
                "map {out} -o map.yaml --odom-frame base_link --overwrite",
                "does not move: the scans are drawn as if it had",
            ),
            ("map {out} -o map.yaml --odom-frame base_link --overwrite", "--odom-frame odom"),
        ),
        (f"{_IN_BASE} --preset slam_toolbox --range-max 20", "map {out} -o map.yaml"),
    ),
    Situation(
        "a lidar whose clock is 1.5 s ahead",
        drive(ahead=1.5),
        (
            (f"{_IN_BASE} --preset slam_toolbox --range-max 20", ""),
            ("check {out} --for slam_toolbox", "the stamps of /scan are 1.4 s ahead of those of /tf"),
            ("check {out} --for slam_toolbox", "made from clouds: pc2scan convert --time-offset auto"),
            (f"{_HALL} --overwrite {_ABOVE} --target-frame odom", "--transform-tolerance 0.91 uses the nearest"),
            (f"{_HALL} --overwrite {_ABOVE} --target-frame odom", "unless the clocks differ, which --time-offset auto"),
        ),
        (f"{_IN_BASE} --preset slam_toolbox --range-max 20", "check {out} --for slam_toolbox"),
        drive(),
    ),
    # Words that are taken for something else.
    Situation(
        "a table as a destination",
        fixture("hall.bag"),
        (("convert {src} -o scans.csv", "pc2scan export"),),
        (_HALL_BAG,),
    ),
    Situation(
        "a page as a destination",
        fixture("hall.bag"),
        (("convert {src} -o page.html", "pc2scan view"),),
        (_HALL_BAG,),
    ),
    Situation(
        "a figure as a destination",
        fixture("hall.bag"),
        (("convert {src} -o figure.png", "pc2scan plot"),),
        (_HALL_BAG,),
    ),
    Situation(
        "a map as a destination",
        fixture("hall.bag"),
        (("convert {src} -o map.yaml", "pc2scan map"),),
        (_HALL_BAG,),
    ),
    Situation(
        "a value for a switch",
        hall(),
        ((f"{_HALL} {_HEIGHTS} --use-inf false", "--no-use-inf"),),
        (f"{_HALL} {_HEIGHTS} --no-use-inf --range-max 20",),
    ),
    Situation(
        "a static transform without quotes",
        hall(),
        ((f"{_IN_BASE} --static-tf base_link lidar 0 0 0.6 0 0 0", "it is one argument, in quotes"),),
        (_typed(0),),
    ),
    Situation("a quoted pattern", hall(), (("convert '*.mcap' -o {out}", "pc2scan batch"),), (f"{_HALL} {_HEIGHTS}",)),
    Situation(
        "clouds accumulated by a bare number",
        drive(),
        ((f"{_IN_BASE} --accumulate 5 --fixed-frame odom", "if clouds were meant: --accumulate 5clouds"),),
        (f"{_IN_BASE} --accumulate 5clouds --fixed-frame odom",),
    ),
    Situation("version as a command", hall(), (("version", "pc2scan --version"),), ("--version",)),
    Situation("help as a command", hall(), (("help convert", "pc2scan convert --help"),), ("convert --help",)),
    Situation(
        "a Git LFS pointer",
        pointer,
        (
            (_HALL, "git lfs pull fetches it"),
            ("info {src}", "git lfs pull fetches it"),
            ("check {src}", "git lfs pull fetches it"),
            ("view {src}", "git lfs pull fetches it"),
            ("map {src} -o map.yaml", "git lfs pull fetches it"),
            ("tf {src}", "git lfs pull fetches it"),
            ("repair {src}", "git lfs pull fetches it"),
            ("export {src} -o scans.csv", "git lfs pull fetches it"),
            ("plot {src} -o figure.png", "git lfs pull fetches it"),
            ("batch {src} -o results", "it is a Git LFS pointer"),
        ),
        (),
    ),
    Situation(
        "a recording with 2D scans only",
        scans_only,
        ((_HALL, "can be used as they are"),),
        (f"{_HALL} {_HEIGHTS}",),
        hall(),
    ),
)
