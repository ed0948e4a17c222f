"""Reads a robot's model (URDF): its fixed joints are static transforms.

Models are untrusted: their size is bounded. Source of the rules: http://wiki.ros.org/urdf/XML/joint, and urdfdom's
parser.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from pc2scan.core.rigid import Rigid
from pc2scan.errors import Pc2ScanError, UsageError

from .static import StaticTransform
from .text_files import text_of
from .xml_tree import xml_tree

if TYPE_CHECKING:
    from pathlib import Path

    from .xml_tree import Element

#: Models of large robots have a megabyte.
MAX_BYTES = 2_000_000

_TO_URDF = "make a URDF of it first: `xacro robot.urdf.xacro > robot.urdf` (ROS 2: `ros2 run xacro xacro ...`)"


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
