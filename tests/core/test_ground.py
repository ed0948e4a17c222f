from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from pc2scan.bags.opening import open_recording
from pc2scan.core.rigid import Rigid
from pc2scan.core.scene import Ground, common_ground, find_ground, thin_points
from pc2scan.messages.pointcloud2 import POINTCLOUD2, decode_pointcloud2
from support import RECORDINGS, needs_shared, sampled
from support.worlds.mounted import PLACES, SENSORS, Place, cloud, mounted, up_in_sensor, without

#: Rolls and pitches, degrees. The full grid is for `tests/fuzz`; this one is coarse, and has odd angles.
MOUNTINGS = [
    *((roll, 0.0) for roll in (-90, -60, -35, -12, 8, 20, 45, 75, 120, 150, 180)),
    *((0.0, pitch) for pitch in (-90, -50, -20, -8, 10, 30, 60, 90, 135, 165)),
    *((roll, pitch) for roll in (-30, 15, 180) for pitch in (-15, 25, 100)),
]


def seen(place: Place, sensor: str, roll: float, pitch: float, height: float, stand: int = 0) -> Ground:
    rotation = mounted(roll, pitch, optical="optical" in sensor)
    return find_ground(thin_points(*cloud(place, sensor, rotation, height, stand).T))


def degrees_between(one: object, other: object) -> float:
    return math.degrees(math.acos(float(np.clip(np.dot(np.asarray(one), np.asarray(other)), -1, 1))))


def verdict(found: Ground, sensor: str, roll: float, pitch: float) -> str:
    """What a finding is worth: ``named``, ``alone``, or what is wrong with it."""
    optical = "optical" in sensor
    up = up_in_sensor(mounted(roll, pitch, optical=optical))
    tilt = degrees_between(up_in_sensor(mounted(roll, pitch)), (0, 0, 1))
    if found.kind == "unknown":
        return "alone"
    if found.kind == "optical":
        if not optical:
            return "wrong: optical"
        return "named" if found.up is None or degrees_between(found.up, up) < 3 else "wrong: another up"
    if found.kind == "level":
        # Nothing is said of it.
        return "alone"
    if found.kind == "slanted":
        return "named" if 10 < tilt < 170 else "wrong: slanted"
    if tilt < 3 or optical:
        return f"wrong: {found.kind}"
    upside_down = tilt > 90
    right = degrees_between(found.up, up) < 3 and (found.kind == "upside-down") == upside_down
    return "named" if right else "wrong: another up"


#: In the quick run; each of them is left alone or named for another reason.
TELLING = {
    ("hall", "camera, optical"), ("corridor", "scattering, ahead"), ("ramp up", "camera"),
    ("warehouse", "64 rings"), ("hall", "16 rings"), ("street", "32 rings"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "sensor"),
    [pair if pair in TELLING else pytest.param(*pair, marks=pytest.mark.slow) for pair in product(PLACES, SENSORS)],
)
def test_every_mounting_is_named_correctly_or_left_alone(name: str, sensor: str) -> None:
    place = PLACES[name]
    open_place = without(without(place, "floor"), "ceiling")
    numbers = np.random.default_rng([list(PLACES).index(name), list(SENSORS).index(sensor)])
    chosen = numbers.choice(len(MOUNTINGS), 3, replace=False)
    for number, (roll, pitch) in enumerate(MOUNTINGS[at] for at in chosen):
        for where in (place, open_place) if number % 3 == 0 else (place,):
            height = place.heights[number % 3]
            found = seen(where, sensor, roll, pitch, height, number)
            assert not verdict(found, sensor, roll, pitch).startswith("wrong"), (roll, pitch, height, found)


@pytest.mark.parametrize(
    ("name", "sensor"), sampled(product(PLACES, [sensor for sensor in SENSORS if "optical" not in sensor]), 9)
)
def test_no_false_alarm_where_it_is_level(name: str, sensor: str) -> None:
    place = PLACES[name]
    places = {"": place, "no floor": without(without(place, "floor"), "ceiling"), "no roof": without(place, "ceiling")}
    if name != "garage":
        # A low ceiling over open space whose floor is not seen is the mirror image of open ground.
        places["only a ceiling"] = without(place, "floor")
    for without_what, where in places.items():
        for stand, height in enumerate(place.heights if not without_what else place.heights[:1]):
            found = seen(where, sensor, 0, 0, height, stand)
            assert not found.off, (without_what, height, found)
            if not without_what and found.up is not None:
                assert found.height == pytest.approx(height, abs=0.12), found


@pytest.mark.parametrize("name", ["hall", "office", "field", "garage"])
@pytest.mark.parametrize("roll", [-25, 12])
def test_a_tilted_lidar_is_named(name: str, roll: float) -> None:
    looks = [seen(PLACES[name], "32 rings", roll, 10, 0.6, stand) for stand in range(3)]
    found = common_ground(looks)
    assert (found.kind, found.sampled) == ("tilted", 3)
    assert found.height == pytest.approx(0.6, abs=0.03)
    level = Rigid.from_rpy(*found.level_from_frame)
    assert degrees_between(level.matrix @ up_in_sensor(mounted(roll, 10)), (0, 0, 1)) < 1
    # Forward stays forward.
    assert level.matrix[1, 0] == pytest.approx(0, abs=1e-9)
    assert np.degrees(found.level_from_frame[:2]) == pytest.approx([roll, 10], abs=1)


@needs_shared
@pytest.mark.parametrize(
    ("name", "kind", "height"),
    [
        ("d435_depth.mcap", "optical", 0.117),
        ("luminar_highway.bag", "level", 3.1),
        ("ouster_os1_32.mcap", "level", 1.85),
        ("velodyne_vlp32.bag", "level", 0.30),
    ],
)
def test_every_real_cloud_is_called_what_it_is(name: str, kind: str, height: float) -> None:
    reader = open_recording(RECORDINGS / name)
    clouds = reader.messages([c for c in reader.connections if c.ros_type == POINTCLOUD2])
    looks = [
        find_ground(thin_points(*decode_pointcloud2(message.data, message.connection.serialization).xyz()))
        for message in clouds
    ]
    reader.close()
    assert {look.kind for look in looks} == {kind}
    assert common_ground(looks).height == pytest.approx(height, rel=0.12)
