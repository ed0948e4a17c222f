"""Static transforms that a user adds: as text, in YAML files, and the fixed joints of a robot's model (URDF).

Models are untrusted: their size is bounded. Source of their rules: http://wiki.ros.org/urdf/XML/joint, and urdfdom's
parser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.core.layout import FULL_TURN
from pc2scan.core.quantities import quantity
from pc2scan.core.rigid import Rigid
from pc2scan.errors import ParameterError, Pc2ScanError, UsageError
from pc2scan.files.yaml import MAX_CHARACTERS, load_yaml

from .text_files import text_of, xml_tree

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.core.rigid import TransformRow

    from .text_files import Element

#: Maximum deviation of a quaternion's length from 1. Rounding to two digits (0.71 0 0 0.71: 1.004) stays below it.
_QUATERNION_SLACK = 0.05

#: Models of large robots have a megabyte.
MAX_BYTES = 2_000_000

_TO_URDF = "make a URDF of it first: `xacro robot.urdf.xacro > robot.urdf` (ROS 2: `ros2 run xacro xacro ...`)"


@dataclass(frozen=True, slots=True)
class StaticTransform:
    """A transform that the user adds; it is valid at any time.

    Attributes
    ----------
    parent, child
        Frame names.
    parent_from_child
        The pose of the child in the parent.
    """

    parent: str
    child: str
    parent_from_child: Rigid

    @classmethod
    def parse(cls, text: str) -> StaticTransform:
        """Read ``parent child x y z qx qy qz qw`` or ``parent child x y z roll pitch yaw``.

        Metres and radians, or with a unit: ``20cm``, ``90deg``.

        Raises
        ------
        UsageError
            If it is neither, both frames are the same, the quaternion is not of unit length, or an angle is more than
            a full turn.
        """
        words = text.replace(",", " ").split()
        usage = "write 'parent child x y z qx qy qz qw' or 'parent child x y z roll pitch yaw' (metres, radians)"
        if len(words) not in (8, 9):
            raise UsageError(f"{text!r} has {len(words)} values, a static transform has 8 or 9", hint=usage)
        units = ("m",) * 3 + (("rad",) * 3 if len(words) == 8 else ("",) * 4)
        numbers = []
        for word, unit in zip(words[2:], units, strict=True):
            number = number_in(word, unit)
            if number is None:
                raise UsageError(f"{' '.join(words)!r} is not a static transform: {word!r} is not a number")
            numbers.append(number)
        parent, child, translation, rotation = words[0], words[1], numbers[:3], numbers[3:]
        if not parent or not child or parent.removeprefix("/") == child.removeprefix("/"):
            raise UsageError(f"a static transform needs two frames, not {parent!r} and {child!r}")
        where = f"static transform from {parent} to {child}"
        _refuse_degrees(where, rotation)
        try:
            if len(rotation) == 3:
                rigid = Rigid.from_rpy(rotation[0], rotation[1], rotation[2], translation)
            else:
                rigid = Rigid(rotation, translation)  # type: ignore[arg-type]
        except ParameterError as err:
            raise UsageError(f"{where}: {err.message}") from err
        return cls(parent, child, rigid)

    def row(self, stamp_ns: int) -> TransformRow:
        """Return the transform as in a TFMessage."""
        return (self.parent, self.child, stamp_ns, *self.parent_from_child.pose)


def number_in(word: str, unit: str) -> float | None:
    """Return a word as a number, in metres or radians; with an empty ``unit`` it must not have one."""
    try:
        return float(word)
    except ValueError:
        return quantity(word, unit) if unit else None


def _refuse_degrees(where: str, rotation: Sequence[float]) -> None:
    """Raise for rotations that are mistakes: angles of more than a full turn, quaternions far from unit length."""
    length = math.hypot(*rotation)
    if len(rotation) == 3 and FULL_TURN < max(map(abs, rotation)) < math.inf:
        degrees = " ".join(f"{angle:g}deg" if angle else "0" for angle in rotation)
        message = f"{where}: {_numbers(rotation)} rad are more than a full turn (2 pi is 6.28319 rad)"
        raise UsageError(message, hint=f"degrees are written {degrees}")
    if len(rotation) == 4 and length and _QUATERNION_SLACK < abs(length - 1) < math.inf:
        message = f"{where}: the quaternion {_numbers(rotation)} has the length {length:.4g}, it must be 1"
        raise UsageError(message, hint="roll, pitch and yaw are three numbers, not four")


def static_text(parent: str, child: str, static: StaticTransform) -> str:
    """Return the text of `static_tf` for the same transform with other names."""
    rigid = static.parent_from_child
    numbers = (*rigid.translation.tolist(), *rigid.rpy)
    return f"{parent} {child} {_numbers(number + 0.0 for number in numbers)}"


def _numbers(numbers: Iterable[float]) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)


def added_transforms(given: Iterable[str | Path | StaticTransform]) -> tuple[StaticTransform, ...]:
    """Return transforms that are objects, texts, or in files."""
    transforms = list(given)
    for item in transforms:
        if not isinstance(item, str | Path | StaticTransform):
            raise TypeError(f"static_tf has {item!r}, it must be text, 'parent child x y z roll pitch yaw'")
    parsed: list[StaticTransform] = []
    for item in transforms:
        if isinstance(item, Path):
            parsed += load_static_transforms(item)
        else:
            parsed.append(StaticTransform.parse(item) if isinstance(item, str) else item)
    return tuple(parsed)


def load_static_transforms(path: Path) -> tuple[StaticTransform, ...]:
    """Read a YAML list of texts as `StaticTransform.parse` reads them.

    Raises
    ------
    UsageError
        If the file cannot be read, or has anything else in it.
    """
    text = text_of(path, MAX_CHARACTERS, "a list of static transforms")
    try:
        document = load_yaml(text)
    except ValueError as err:
        raise UsageError(str(err), path=path) from err
    if not isinstance(document, list) or not all(isinstance(entry, str) for entry in document):
        raise UsageError(
            "is not a YAML list of static transforms",
            path=path,
            hint="each line is '- parent child x y z roll pitch yaw'",
        )
    transforms = []
    for number, entry in enumerate(document, 1):
        try:
            transforms.append(StaticTransform.parse(entry))
        except UsageError as err:
            raise UsageError(f"entry {number}: {err.message}", path=path, hint=err.hint) from err
    return tuple(transforms)


class RobotModel(NamedTuple):
    """A robot's model, as far as transforms go: the file or the topic, and its fixed joints in order."""

    name: str
    joints: tuple[StaticTransform, ...]


def model_in_file(path: Path) -> RobotModel:
    """Read a URDF file.

    Raises
    ------
    UsageError
        If it cannot be read, or is not a URDF.
    """
    text = text_of(path, MAX_BYTES, "a URDF")
    try:
        return parse_model(text, str(path))
    except UsageError as err:
        err.path = path
        raise


def parse_model(text: str, name: str) -> RobotModel:
    """Read the text of a URDF; ``name`` is the file or the topic.

    Raises
    ------
    UsageError
        If it is not a URDF, or a joint is not one.
    """
    if len(text) > MAX_BYTES:
        raise UsageError(f"has {len(text):,} characters; a URDF has at most {MAX_BYTES:,}")
    root = xml_tree(text)
    if root.tag != "robot":
        raise UsageError(f"line {root.line}: is not a URDF: its root is <{root.tag}>, not <robot>")
    joints: dict[str, StaticTransform] = {}
    for element in root.children:
        if element.tag.startswith("xacro:"):
            raise UsageError(f"line {element.line}: is not a URDF, but a xacro file", hint=_TO_URDF)
        if element.tag == "joint" and element.attributes.get("type") == "fixed":
            joint = _transform_of(element)
            joints.setdefault(joint.child, joint)
    return RobotModel(name, tuple(joints.values()))


def _transform_of(joint: Element) -> StaticTransform:
    """Return the pose of the child link in the parent link."""
    parts = {element.tag: element.attributes for element in joint.children}
    parent, child = (parts.get(tag, {}).get("link", "") for tag in ("parent", "child"))
    origin = parts.get("origin", {})
    what = f"line {joint.line}: joint {joint.attributes.get('name', '')!r}"
    try:
        xyz, rpy = ([float(word) for word in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
        roll, pitch, yaw = rpy
        rigid = Rigid.from_rpy(roll, pitch, yaw, xyz)
    except ValueError as err:
        hint = _TO_URDF if "${" in str(origin) else None
        raise UsageError(f"{what} has the origin {origin}, which is not two times three numbers", hint=hint) from err
    except Pc2ScanError as err:
        raise UsageError(f"{what}: {err.message}") from err
    if not parent or not child or parent == child:
        raise UsageError(f"{what} needs two links, not {parent!r} and {child!r}")
    return StaticTransform(parent, child, rigid)
