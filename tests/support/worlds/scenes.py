"""Simulated places with floors, ceilings, furniture and people, and what robots with lidars record in them.

A world is a row of data. What it gives at a height is known exactly: every return has its true place, so a scan can be
judged by those within a band of heights above the floor.
"""

from __future__ import annotations

import math
import shlex
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.bags.opening import open_recording
from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.messages.tfmessage import encode_transforms
from support.builders import CLOUD, TF
from support.clouds import structured
from support.command import run
from support.containers import write_rows
from support.worlds.moving import BEGIN_NS, Drive
from support.worlds.posed import KINDS, message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_NOISE = 0.01
_FAR = 100.0
_SECONDS = 2.4

DRIVES = {"stands": Drive(0.0, 0.0), "drives": Drive(0.6, 0.3), "pitches": Drive(0.4, 0.2, tilt=math.radians(3.0))}


def _rings(low: float, high: float, count: int, columns: int) -> tuple[Floats, Floats]:
    """Azimuth and elevation of each ray of a turn, in the order of time."""
    azimuth = np.repeat(-math.pi + np.arange(columns) * (math.tau / columns), count)
    return azimuth, np.tile(np.radians(np.linspace(low, high, count)), columns)


def _scatter(low: float, high: float, count: int, seed: int) -> tuple[Floats, Floats]:
    random = np.random.default_rng(seed)
    sines = np.sin(np.radians((low, high)))
    return random.uniform(-math.pi, math.pi, count), np.arcsin(random.uniform(sines[0], sines[1], count))


#: What a lidar measures in a tenth of a second, by the number of the turn; and in how many messages.
SENSORS: dict[str, tuple[Callable[[int], tuple[Floats, Floats]], int]] = {
    "1 ring": (lambda _: _rings(0, 0, 1, 720), 1),
    "2 rings": (lambda _: _rings(-2, 2, 2, 720), 1),
    "4 rings": (lambda _: _rings(-3.2, 3.2, 4, 720), 1),
    "16 rings": (lambda _: _rings(-15, 15, 16, 360), 1),
    "32 even rings": (lambda _: _rings(-15, 15, 32, 360), 1),
    "32 rings": (lambda _: _rings(-25, 15, 32, 240), 1),
    "64 rings": (lambda _: _rings(-24.8, 2, 64, 180), 1),
    "mid-360": (lambda turn: _scatter(-7, 52, 20000, turn), 1),
    "thin mid-360": (lambda turn: _scatter(-7, 52, 2000, turn), 1),
    "packets": (lambda _: _rings(-15, 15, 16, 360), 20),
    "sparse": (lambda turn: _scatter(-15, 15, 120, turn), 1),
}


@dataclass(frozen=True)
class World:
    """A recording of a robot in a place.

    Attributes
    ----------
    room
        x0, x1, y0, y1 and height of a closed room; None: under the open sky.
    boxes
        What stands or hangs there: x0, x1, y0, y1, z0, z1 of each, above the ground at its middle.
    sensor, mount
        A key of `SENSORS`, and base_link_from_lidar: x, z, roll, pitch, yaw (degrees).
    drive
        A key of `DRIVES`.
    slope
        How the ground rises, from two metres ahead of where the robot begins.
    has_mount, odometry
        Whether its mount is recorded; ``tf``, ``topic`` or nothing.
    placed_in
        The frame that the clouds are in already: that of the odometry, or ``base_link``; empty: that of their lidar.
    second
        Whether there is a second lidar, at the other end of the robot.
    axle
        The height of base_link above the floor.
    claim
        The roll of the recorded mount, if it is not the true one, degrees.
    pair
        The frames of the odometry.
    clock, late, unit
        Seconds by which the clock of its lidars is ahead, and after which odometry begins; and their unit, metres.
    mounted_by
        The topic with mounts.
    """

    room: tuple[float, float, float, float, float] | None
    boxes: tuple[tuple[float, ...], ...] = ()
    sensor: str = "16 rings"
    mount: tuple[float, float, float, float, float] = (0.2, 0.5, 0.0, 0.0, 0.0)
    drive: str = "stands"
    slope: float = 0.0
    has_mount: bool = True
    odometry: str = "tf"
    placed_in: str = ""
    second: bool = False
    axle: float = 0.0
    claim: float | None = None
    pair: tuple[str, str] = ("odom", "base_link")
    clock: float = 0.0
    late: float = -0.4
    unit: float = 1.0
    mounted_by: str = "/tf_static"

    @property
    def lidars(self) -> dict[str, Rigid]:
        """base_link_from_lidar by the names of topics; base_link here is on the floor."""
        x, z, *angles = self.mount
        roll, pitch, yaw = map(math.radians, angles)
        first = {"points": Rigid.from_rpy(roll, pitch, yaw, (x, 0.0, z))}
        return first | ({"rear": Rigid.from_rpy(0.0, 0.0, math.pi, (-x, 0.0, z + 0.1))} if self.second else {})

    def ground(self, x: Floats) -> Floats:
        """How high the ground is."""
        return np.asarray(self.slope * np.clip(x - 2.0, 0.0, None))

    def cast(self, origins: Floats, rays: Floats) -> Floats:
        """Return how far it is to what each ray meets, metres; infinite for nothing."""
        with np.errstate(divide="ignore", invalid="ignore"):
            nearest = -origins[:, 2] / rays[:, 2]
            nearest[~((nearest > 0) & (origins[:, 0] + nearest * rays[:, 0] < 2.0)) & (self.slope > 0)] = np.inf
            nearest[~(nearest > 0)] = np.inf
            if self.slope:
                climbs = (self.slope * (origins[:, 0] - 2) - origins[:, 2]) / (rays[:, 2] - self.slope * rays[:, 0])
                climbs[~((climbs > 0) & (origins[:, 0] + climbs * rays[:, 0] >= 2.0))] = np.inf
                nearest = np.minimum(nearest, climbs)
            if self.room is not None:
                x0, x1, y0, y1, height = self.room
                for axis, wall in ((0, x0), (0, x1), (1, y0), (1, y1), (2, height)):
                    distance = (wall - origins[:, axis]) / rays[:, axis]
                    nearest = np.minimum(nearest, np.where(distance > 0, distance, np.inf))
            for x0, x1, y0, y1, z0, z1 in self.boxes:
                at = float(self.ground(np.array((x0 + x1) / 2)))
                ways = [
                    (np.array([[low], [high]]) - origins[:, axis]) / rays[:, axis]
                    for axis, (low, high) in enumerate(((x0, x1), (y0, y1), (z0 + at, z1 + at)))
                ]
                enters, leaves = np.max([way.min(0) for way in ways], 0), np.min([way.max(0) for way in ways], 0)
                nearest = np.minimum(nearest, np.where((enters > 0) & (enters <= leaves), enters, np.inf))
        return nearest

    @cached_property
    def turns(self) -> list[Turn]:
        """What its lidars measure."""
        drive, random = DRIVES[self.drive], np.random.default_rng(5)
        found = []
        for name, mount in self.lidars.items():
            for number in range(round(_SECONDS * 10)):
                azimuth, elevation = SENSORS[self.sensor][0](number)
                times = number * 0.1 + np.linspace(0.0, 0.1, len(azimuth), endpoint=False)
                flat = np.cos(elevation)
                rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
                base = drive.rotations(times)
                origins = drive.positions(times) + base @ mount.translation
                cast = np.einsum("nij,jk,nk->ni", base, mount.matrix, rays)
                ranges = self.cast(origins, cast)
                hit = (ranges > 0.1) & (ranges < _FAR)
                true = origins + np.where(hit, ranges, 0)[:, None] * cast
                ranges = ranges + random.normal(0, _NOISE, len(ranges))
                own = np.where(hit, ranges, np.nan)[:, None] * rays
                if self.placed_in == self.pair[0]:
                    own = origins + np.where(hit, ranges, np.nan)[:, None] * cast
                elif self.placed_in:
                    own = mount.apply(own) - (0.0, 0.0, self.axle)
                found.append(Turn(name, times, own, true, hit))
        return found

    def write(self, path: Path) -> Path:
        """Write it as an MCAP file."""
        drive = DRIVES[self.drive]
        lift = Rigid.from_rpy(0.0, 0.0, 0.0, (0.0, 0.0, self.axle))
        rows: list[tuple[int, str, bytes]] = []
        types = {f"/{name}": CLOUD for name in self.lidars}
        if self.has_mount:
            types[self.mounted_by] = TF
            mounts = [("base_link", name, lift.inverse().compose(each)) for name, each in self.lidars.items()]
            if self.claim is not None:
                x, z, _, pitch, yaw = self.mount
                claimed = Rigid.from_rpy(math.radians(self.claim), math.radians(pitch), math.radians(yaw), (x, 0.0, z))
                mounts = [("base_link", "points", claimed)]
            for at_ns in range(-500, 3_000 if self.mounted_by == "/tf" else -400, 100):
                stamp_ns = BEGIN_NS + at_ns * 1_000_000
                static = [(parent, child, stamp_ns, *rigid.pose) for parent, child, rigid in mounts]
                rows.append((stamp_ns, self.mounted_by, encode_transforms(static, "cdr")))
        if self.odometry:
            topic = "/tf" if self.odometry == "tf" else "/odom"
            types[topic] = TF if self.odometry == "tf" else KINDS["odometry"]
        for number in range(round(self.late * 50), round(_SECONDS * 50) + 20) if self.odometry else ():
            pose = drive.pose(number / 50).compose(lift).pose
            stamp_ns = BEGIN_NS + number * 20_000_000
            if self.odometry == "tf":
                data = encode_transforms([(*self.pair, stamp_ns, *pose)], "cdr")
            else:
                data = message("odometry", 2, 0, stamp_ns, self.pair, pose)
            rows.append((stamp_ns, topic, data))
        for turn in self.turns:
            parts = SENSORS[self.sensor][1]
            for times, points in zip(np.split(turn.times, parts), np.split(turn.points, parts), strict=True):
                stamp_ns = BEGIN_NS + round((times[0] + self.clock) * 1e9)
                data = _cloud(self.placed_in or turn.name, stamp_ns, times - times[0], points / self.unit)
                rows.append((BEGIN_NS + round(times[-1] * 1e9) + 2_000_000, f"/{turn.name}", data))
        return write_rows(path, types, sorted(rows))

    @property
    def top(self) -> float:
        """The top of the band in which its scans are judged, metres above the floor."""
        return 1.5 if self.room is None else min(1.5, self.room[4] - 0.2)


class Turn(NamedTuple):
    """A turn of a lidar: the times of rays (N,), what is recorded, true places in odom (N, 3), and which rays hit."""

    name: str
    times: Floats
    points: Floats
    true: Floats
    hit: NDArray[np.bool_]


def _cloud(frame: str, stamp_ns: int, times: Floats, xyz: Floats) -> bytes:
    points = np.empty(len(times), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
    for axis, values in zip("xyz", xyz.T, strict=True):
        points[axis] = values
    points["t"] = np.round(times * 1e9)
    return structured(points, 2, stamp_ns=stamp_ns, frame_id=frame)


class Outcome(NamedTuple):
    """What became of the command that `info` proposes.

    Attributes
    ----------
    word
        ``right``; ``told`` if `info` says what it does not know; ``wrong``.
    right, filled
        The share of returns that are where the scene has something within the band, and the share of the beams that it
        fills which have a return.
    text
        The command and what was said.
    """

    word: str
    right: float
    filled: float
    text: str


def outcome(world: World, folder: Path) -> Outcome:
    """Paste what `info` shows last, and judge the scans."""
    path = world.write(folder / "drive.mcap")
    shown = run("info", path)
    lines = shown.stdout.splitlines()
    commands = lines[lines.index("ready to convert:") + 1 :] if "ready to convert:" in lines else []
    said = f"info: {shown.stderr.strip()}" if shown.stderr.strip() else ""
    if shown.status or not commands:
        return Outcome("told" if said and not shown.status else "wrong", 0.0, 0.0, said or shown.stdout)
    before, notes, is_sound = set(folder.iterdir()), [said] if said else [], True
    for command in commands:
        done = run(*shlex.split(command)[1:])
        is_sound = is_sound and not (done.status or done.stderr)
        notes += [command.replace(str(path), "DRIVE"), f"status {done.status} {done.stderr.strip()}"]
    found = [judged(world, scans) for scans in sorted(set(folder.iterdir()) - before)]
    right, filled = (min((each[place] for each in found), default=0.0) for place in (0, 1))
    word = "right" if is_sound and right >= 0.95 and filled >= 0.9 else "told" if said else "wrong"
    return Outcome(word, right, filled, "\n".join(notes))


def _scans(path: Path) -> list[LaserScan]:
    with closing(open_recording(path)) as reader:
        flat = [each for each in reader.connections if each.ros_type == LASERSCAN]
        return [decode_laserscan(each.data, each.connection.serialization) for each in reader.messages(flat)]


def judged(world: World, path: Path) -> tuple[float, float]:
    """Return the share of returns that are right, and of beams that have one where the scene fills them."""
    drive = DRIVES[world.drive]
    counts = np.zeros(4)
    every = np.concatenate([turn.true[turn.hit] for turn in world.turns])
    at = np.concatenate([turn.times[turn.hit] for turn in world.turns])
    height = every[:, 2] - world.ground(every[:, 0])
    margin = 0.02 + (0.05 if world.slope else 0.0)
    known = (height > 0.1 - margin) & (height < world.top + margin)
    every, at, height = every[known], at[known], height[known]
    firm = (height > 0.1 + margin) & (every[:, 2] < world.top - margin)
    # When a scan was measured: a turn from its stamp on; of packets, around it; of a sparse pattern, 1 s before.
    before, after = {"sparse": (1.0, 0.1), "packets": (0.15, 0.15)}.get(world.sensor, (0.01, 0.11))
    for scan in _scans(path):
        time = (scan.stamp_ns - BEGIN_NS) / 1e9
        place = drive.pose(time)
        if not scan.frame_id.startswith("base_link"):
            place = place.compose(world.lidars.get(scan.frame_id.removesuffix("_level"), Rigid.identity()))
        yaw = math.atan2(place.matrix[1, 0], place.matrix[0, 0])
        off = every[:, :2] - place.translation[:2]
        ranges, angles = np.hypot(*off.T), np.arctan2(off[:, 1], off[:, 0]) - yaw
        step = abs(scan.angle_increment)
        beams = np.floor(np.remainder(angles - scan.angle_min + step / 2, math.tau) / step).astype(int)
        got = scan.ranges.astype(float)
        is_return = np.isfinite(got) & (got >= scan.range_min) & (got <= scan.range_max)
        right = np.zeros(len(got), bool)
        for shift in (-1, 0, 1):
            beam = beams + shift
            inside = (beam >= 0) & (beam < len(got))
            beam = beam[inside]
            fits = np.abs(got[beam] - ranges[inside]) < 0.05 + ranges[inside] * step / 2
            right[beam[fits]] = True
        filled = np.zeros(len(got), bool)
        now = firm & (at > time - before) & (at < time + after) & (beams >= 0) & (beams < len(got))
        now &= (ranges > scan.range_min) & (ranges < min(scan.range_max, 20))
        filled[beams[now]] = True
        counts += (right[is_return].sum(), is_return.sum(), (is_return & filled).sum(), filled.sum())
    right, filled = counts[0::2] / np.maximum(counts[1::2], 1)
    return float(right), float(filled)


def furniture(random: np.random.Generator, room: tuple[float, ...], count: int) -> Iterator[tuple[float, ...]]:
    """Boxes on the floor, and people, none near the robot."""
    x0, x1, y0, y1 = room[:4]
    for number in range(count):
        for _ in range(20):
            x, y = random.uniform(x0, x1), random.uniform(y0, y1)
            wide, deep, tall = random.uniform(0.3, 1.2), random.uniform(0.3, 0.9), random.uniform(0.3, 1.8)
            if number % 3 == 0:
                wide, deep, tall = 0.45, 0.3, 1.7
            if math.hypot(x - 0.6, y) > 1.2 + max(wide, deep):
                yield (x, x + wide, y, y + deep, 0.0, tall)
                break


def random_world(seed: int) -> tuple[str, World]:
    """Return a world of any kind, and its name."""
    random = np.random.default_rng(seed)
    kind = str(random.choice(["room", "room", "hall", "corridor", "office", "yard", "street", "slope"]))
    height = float(random.uniform(2.4, 4.0))
    length, width = float(random.uniform(4, 14)), float(random.uniform(4, 10))
    if kind == "hall":
        length, width, height = random.uniform(14, 40), random.uniform(10, 25), random.uniform(4, 8)
    elif kind == "corridor":
        length, width, height = random.uniform(10, 40), random.uniform(1.8, 3.0), random.uniform(2.4, 3.5)
    elif kind == "office":
        length, width, height = random.uniform(4, 8), random.uniform(4, 6), random.uniform(2.4, 3.0)
    behind = float(random.uniform(0.3, 0.5))
    slope, walls = 0.0, []
    if kind in {"yard", "street", "slope"}:
        length, width = random.uniform(20, 40), random.uniform(10, 25)
        x0, x1, y0, y1 = -behind * length, (1 - behind) * length, -width / 2, width / 2
        walls = [(x0 - 3, x1 + 3, y1, y1 + 3, 0.0, 6.0), (x0 - 3, x1 + 3, y0 - 3, y0, 0.0, 8.0)]
        if kind != "street":
            walls += [(x1, x1 + 3, y0, y1, 0.0, 5.0)]
        slope = float(random.uniform(0.04, 0.15)) if kind == "slope" else 0.0
        if slope:
            walls = [(x1, x1 + 3, y0, y1, 0.0, 5.0), (x0 - 3, x0, y0, y1, 0.0, 5.0)]
            walls += [(x, x + 2, y, y + 1, -1.0, 6.0) for x in np.arange(x0, x1, 4) for y in (y0, y1)]
    room = (-behind * length, (1 - behind) * length, -width / 2, width / 2, height)
    pieces = int(random.integers(0, 4 if kind == "corridor" else 12))
    boxes = [] if kind == "corridor" else [*furniture(random, room, pieces)]
    tallest = min(2.2, height - 0.3)
    sensor = str(random.choice([*SENSORS, "16 rings", "32 rings", "mid-360"]))
    mount = (
        float(random.uniform(0.0, 0.3)),
        float(random.uniform(0.2, tallest)),
        0.0,
        0.0,
        float(random.choice([0, 90])),
    )
    if sensor in {"1 ring", "2 rings", "4 rings"}:
        mount = (mount[0], min(mount[1], 1.2), *mount[2:])
    drive = str(random.choice([*DRIVES]))
    has_mount = bool(random.uniform() < 0.75)
    odometry = "tf" if has_mount else ""
    if random.uniform() < 0.15:
        odometry = "topic" if has_mount and drive != "pitches" else odometry
    world = World(
        room if not walls else None, (*boxes, *walls), sensor, mount, drive, slope, has_mount, odometry,
        placed_in="odom" * (odometry == "tf" and sensor not in {"packets", "sparse"} and random.uniform() < 0.08),
        second=has_mount and sensor in {"16 rings", "32 rings"} and random.uniform() < 0.2,
    )  # fmt: skip
    if not odometry:
        world = replace(world, drive="stands")
    marks = {"no mount": not has_mount, "in odom": world.placed_in, "two": world.second, "topic": odometry == "topic"}
    name = f"{seed} {kind} {sensor} {world.mount[1]:.2f} m {world.drive}"
    return ", ".join([name, *(mark for mark, is_so in marks.items() if is_so)]), world
