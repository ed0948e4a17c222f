"""Reads a robot's model (URDF): its fixed joints are static transforms.

Models are untrusted: their size and depth are bounded, and document types are refused, because they can declare
entities. Source of the rules: http://wiki.ros.org/urdf/XML/joint, and urdfdom's parser.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

from pc2scan.core.rigid import Rigid
from pc2scan.errors import Pc2ScanError, UsageError

from .static import StaticTransform
from .text_files import text_of

if TYPE_CHECKING:
    from pathlib import Path

#: Models of large robots have a megabyte, and some hundred joints.
MAX_BYTES = 20_000_000
_MAX_JOINTS = 10_000
_MAX_DEPTH = 100

_TO_URDF = "make a URDF of it first: `xacro robot.urdf.xacro > robot.urdf` (ROS 2: `ros2 run xacro xacro ...`)"


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A robot's model, as far as transforms go.

    Attributes
    ----------
    name
        The file, or the topic.
    joints
        The transforms of its fixed joints, in the order of the file.
    moving
        The links that other joints move, with the type of their joint.
    """

    name: str
    joints: tuple[StaticTransform, ...]
    moving: dict[str, str] = field(default_factory=dict)


#: Nothing is known of the robot, and nothing is read of it in the recording.
NO_MODEL = RobotModel("", ())


class _ModelError(UsageError):
    """What is wrong with a model, with the line."""


@dataclass(slots=True)
class _Joint:
    """A joint as it is written."""

    name: str
    kind: str
    line: int
    parent: str = ""
    child: str = ""
    xyz: str = "0 0 0"
    rpy: str = "0 0 0"

    def transform(self) -> StaticTransform:
        """Return the pose of the child link in the parent link, when the joint is at 0."""
        try:
            numbers = [[float(word) for word in text.split()] for text in (self.xyz, self.rpy)]
        except ValueError:
            numbers = []
        if [len(each) for each in numbers] != [3, 3]:
            raise _ModelError(
                f"line {self.line}: the origin of joint {self.name!r} is xyz={self.xyz!r} rpy={self.rpy!r}, which are "
                "not three numbers each"
            )
        if not self.parent or not self.child or self.parent == self.child:
            raise _ModelError(
                f"line {self.line}: joint {self.name!r} needs two links, not {self.parent!r} and {self.child!r}"
            )
        try:
            roll, pitch, yaw = numbers[1]
            return StaticTransform(self.parent, self.child, Rigid.from_rpy(roll, pitch, yaw, numbers[0]))
        except Pc2ScanError as err:
            raise _ModelError(f"line {self.line}: joint {self.name!r}: {err.message}") from err


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
        raise _ModelError(f"has {len(text):,} characters; a URDF has at most {MAX_BYTES:,}")
    joints = _joints_of(text)
    fixed, moving = dict[str, StaticTransform](), dict[str, str]()
    for joint in joints:
        if joint.kind == "fixed":
            fixed.setdefault(joint.child, joint.transform())
        elif joint.child:
            moving.setdefault(joint.child, joint.kind)
    return RobotModel(name, tuple(fixed.values()), moving)


def _joints_of(text: str) -> list[_Joint]:
    """Return the joints of a model. ElementTree is not used: it has no line numbers, and always expands entities."""
    joints: list[_Joint] = []
    path: list[str] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        if not path and tag != "robot":
            raise _ModelError(f"line {line}: is not a URDF: its root is <{tag}>, not <robot>")
        if tag.startswith("xacro:"):
            raise _ModelError(f"line {line}: is not a URDF, but a xacro file: it has <{tag}>", hint=_TO_URDF)
        if len(path) >= _MAX_DEPTH:
            raise _ModelError(f"line {line}: nested more than {_MAX_DEPTH} levels deep")
        path.append(tag)
        # Joints inside of <transmission> or <gazebo> name others.
        if path == ["robot", "joint"]:
            if len(joints) >= _MAX_JOINTS:
                raise _ModelError(f"line {line}: it has more than {_MAX_JOINTS:,} joints")
            joints.append(_Joint(attributes.get("name", ""), attributes.get("type", ""), line))
        elif path[:-1] == ["robot", "joint"]:
            joint = joints[-1]
            if tag in ("parent", "child"):
                setattr(joint, tag, attributes.get("link", ""))
            elif tag == "origin":
                joint.xyz, joint.rpy = attributes.get("xyz", joint.xyz), attributes.get("rpy", joint.rpy)
        if path[:2] == ["robot", "joint"] and (expression := next((v for v in attributes.values() if "${" in v), None)):
            raise _ModelError(f"line {line}: is not a URDF, but a xacro file: it has {expression!r}", hint=_TO_URDF)

    def refuse(*_declared: object) -> None:
        raise _ModelError(
            f"line {parser.CurrentLineNumber}: it declares a document type, which is not supported",
            hint="remove the <!DOCTYPE ...>; a URDF needs none",
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _tag: path.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text.encode("utf-8", "surrogateescape"), True)
    except expat.ExpatError as err:
        raise _ModelError(f"line {err.lineno}: is not XML: {expat.ErrorString(err.code)}") from err
    except UnicodeDecodeError as err:
        raise _ModelError(f"is not XML: {err.reason}") from err
    return joints
