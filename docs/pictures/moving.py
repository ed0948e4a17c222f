"""Makes ``moving.png`` of the README again: ``python docs/pictures/moving.py [FOLDER]``.

One scan of each of three simulated robots, converted without and with the options that place its points rightly. Needs
what the tests need, and matplotlib.
"""

from __future__ import annotations

import subprocess
import sys
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from pc2scan.bags.opening import open_recording  # noqa: E402
from pc2scan.core.rigid import Rigid  # noqa: E402
from pc2scan.messages.laserscan import decode_laserscan  # noqa: E402
from support.worlds.moving import BEGIN_NS, WALLS, Drive, Lidar, off_the_walls, returns_in_odom, write_world  # noqa: E402  # not installed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

COMMON = (
    "--only-scans", "--target-frame", "base_link", "--min-height", "0.1", "--max-height", "2", "--range-max", "30",
    "--angle-increment", "0.5deg", "--geometry", "centered",
)  # fmt: skip
DESKEW = ("--deskew", "--fixed-frame", "odom")
GOOD, BAD = "#1f5fa8", "#d1342f"


class CornerLidar(Lidar):
    """A lidar at a corner of a robot, which hides a quarter of the room from it."""

    def sweeps(self, seconds: float) -> Iterator[tuple[float, NDArray[np.float64], NDArray[np.float64]]]:
        """When each message begins, the times of its rays after that, and their directions (N, 3)."""
        for begin, times, directions in super().sweeps(seconds):
            seen = np.arctan2(np.abs(directions[:, 1]), directions[:, 0]) < np.radians(135)
            yield begin, times[seen], directions[seen]


@dataclass(frozen=True)
class Robot:
    """A robot, the options of two conversions, and what is written above them."""

    drive: Drive
    lidars: tuple[Lidar, ...]
    plain: tuple[str, ...]
    better: tuple[str, ...]
    says: tuple[str, str]


ROBOTS = (
    Robot(
        Drive(speed=1.5, turn=1.0),
        (Lidar(),),
        (),
        DESKEW,
        ("a robot that drives and turns", "--deskew --fixed-frame odom"),
    ),
    Robot(
        Drive(speed=0.5, turn=0.0, tilt=float(np.radians(3.0))),
        (Lidar(),),
        (),
        ("--level", *DESKEW),
        ("one that tilts by 3 degrees", "--deskew --level --fixed-frame odom"),
    ),
    Robot(
        Drive(speed=1.5, turn=1.0),
        (
            CornerLidar("/front", "front", Rigid.from_rpy(0.0, 0.0, np.pi / 4, (0.4, 0.3, 0.5))),
            CornerLidar("/rear", "rear", Rigid.from_rpy(0.0, 0.0, -3 * np.pi / 4, (-0.4, -0.3, 0.5)), phase=0.03),
        ),
        ("--topic", "/front:=/scan"),
        ("--topic", "/front:=/scan", "--topic", "/rear:=/scan", *DESKEW),
        ("one of two lidars, at a corner", "--topic /front:=/scan --topic /rear:=/scan\n--deskew --fixed-frame odom"),
    ),
)


class Picture(NamedTuple):
    """The returns of a scan, (N, 2) in odom, how far each is from the nearest wall, and where the robot is; metres."""

    points: NDArray[np.float64]
    off: NDArray[np.float64]
    robot: tuple[float, float]


def converted(robot: Robot, world: Path, options: Sequence[str]) -> Picture:
    """Convert a world, and return the scan in its middle."""
    scans = world.with_name("scans.mcap")
    words = ["convert", str(world), "-o", str(scans), "--overwrite", *COMMON, *options]
    subprocess.run([sys.executable, "-m", "pc2scan", *words], check=True, capture_output=True)  # noqa: S603
    with closing(open_recording(scans)) as reader:
        made = [decode_laserscan(m.data, "cdr") for m in reader.messages() if m.connection.topic == "/scan"]
    scan = made[len(made) // 2]
    level = scan.frame_id.endswith("_stabilized")
    points = returns_in_odom(scan, replace(robot.drive, tilt=0.0) if level else robot.drive)
    x, y, _ = robot.drive.positions(np.array([(scan.stamp_ns - BEGIN_NS) / 1e9]))[0].tolist()
    return Picture(points, off_the_walls(points), (x, y))


def draw(axes: Axes, picture: Picture, title: str) -> None:
    """Draw a scan and the walls; returns that are more than 5 cm off are red."""
    (_, left), (_, right), (_, low), (_, high) = WALLS
    axes.plot([left, right, right, left, left], [low, low, high, high, low], color="#c8c8c8", linewidth=3, zorder=0)
    wrong = picture.off > 0.05
    for chosen, colour in ((~wrong, GOOD), (wrong, BAD)):
        axes.plot(*picture.points[chosen].T, ".", color=colour, markersize=2.5)
    axes.plot(*picture.robot, "o", color="#202020", markersize=5)
    axes.set_title(title, fontsize=8)
    axes.set(aspect="equal", xlim=(left - 1, right + 1), ylim=(low - 1, high + 1), xticks=[], yticks=[])
    axes.set_frame_on(False)


def main(folder: Path) -> None:
    """Make the picture."""
    from matplotlib.figure import Figure  # noqa: PLC0415  # an extra

    figure = Figure(figsize=(9, 6.2), layout="constrained")
    for column, robot in enumerate(ROBOTS):
        with TemporaryDirectory() as temporary:
            world = write_world(Path(temporary) / "world.mcap", robot.lidars, robot.drive, seconds=1.0)
            pictures = [converted(robot, world, options) for options in (robot.plain, robot.better)]
        for row, (picture, says) in enumerate(zip(pictures, robot.says, strict=True)):
            draw(figure.add_subplot(2, 3, 1 + 3 * row + column), picture, says)
    figure.savefig(folder / "moving.png", dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else HERE)
