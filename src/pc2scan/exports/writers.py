"""The formats: a function each, which writes a topic, and their table. The poses that they write.

Each function yields one that writes a message, and completes the file when its block ends. Poses are interpolated by
tf2's rules (see `pc2scan.transforms.buffer`) and never extrapolated.
"""

from __future__ import annotations

import re
import shutil
import zipfile
from collections import Counter
from contextlib import ExitStack, contextmanager
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.advice.odometry import odometry_of
from pc2scan.core.rigid import IDENTITY_POSE
from pc2scan.errors import TransformError, UnwritableError, UsageError, name_list, stamp_text, visible
from pc2scan.text import did_you_mean
from pc2scan.transforms.frames import BODIES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path
    from typing import TypeAlias

    from numpy.typing import ArrayLike, NDArray

    from pc2scan.core.rigid import Rigid
    from pc2scan.streams.objects import Cloud, Scan
    from pc2scan.transforms.reading import RecordedTransforms

    #: Writes a message, a `pc2scan.Scan` or a `pc2scan.Cloud`, with the poses at its stamp; None without poses.
    Write: TypeAlias = Callable[[Any, "MessagePoses | None"], None]


class MessagePoses(NamedTuple):
    """The poses of the robot, and of a message's sensor, at the message's stamp.

    Attributes
    ----------
    pose_frame, base_frame, sensor_frame
        The frame of reference of the poses, the robot's frame, and the message's own.
    robot
        The pose of ``base_frame``.
    sensor
        Returns the pose of the message's own frame, or raises a `TransformError` if ``base_frame`` has no transform to
        it.
    """

    pose_frame: str
    base_frame: str
    sensor_frame: str
    robot: Rigid
    sensor: Callable[[], Rigid]


class RobotPoses:
    """The poses of a recording.

    The base frame, if none is given: with poses of a topic and no ``pose_frame``, the frame that these poses move;
    otherwise ``base_link`` or ``base_footprint``, or without these, the message's own.

    Parameters
    ----------
    recorded
        All transforms of the recording.
    pose_frame, base_frame
        As given; empty for none.
    source_frame
        Replaces the frame of messages; empty for their own.

    Raises
    ------
    UsageError
        If a frame does not exist.
    """

    def __init__(self, recorded: RecordedTransforms, pose_frame: str, base_frame: str, source_frame: str) -> None:
        self._transforms = recorded.buffer
        known = sorted(recorded.buffer.frames)
        for option, name in (("pose_frame", pose_frame), ("base_frame", base_frame)):
            if name and name.removeprefix("/") not in known:
                hint = f"{did_you_mean(name, known)} frames: {name_list(known)}; `odom_topic` adds odometry".strip()
                raise UsageError(f"`{option}`: no transforms have the frame {name!r}", hint=hint)
        moved = (attachment for added in recorded.poses if added.reading for attachment in added.attachments.values())
        odometry = None if pose_frame else next(moved, None)
        self.pose_frame = pose_frame.removeprefix("/") or (odometry.parent if odometry else "")
        body = next((name for name in BODIES if name in known), "")
        self._base_frame = base_frame.removeprefix("/") or (odometry.frame if odometry else body)
        self._source_frame = source_frame
        self._bases: dict[str, None] = {}

    def at(self, item: Scan | Cloud) -> MessagePoses:
        """Return the poses at the stamp of a message.

        Raises
        ------
        TransformError
            If there is no pose at the stamp, or the stamp is 0.
        """
        frame, stamp_ns = (self._source_frame or item.frame).removeprefix("/"), item.stamp_ns
        if stamp_ns == 0:
            raise TransformError("its stamp is 0, so the robot's pose is unknown")
        base, lookup = self._base_frame or frame, self._transforms.lookup
        self._bases[base] = None
        robot = lookup(self.pose_frame, base, stamp_ns)
        return MessagePoses(self.pose_frame, base, frame, robot, lambda: robot.compose(lookup(base, frame, stamp_ns)))

    def doubts(self) -> Iterator[str]:
        """Yield what may be wrong with the poses that were read."""
        for base in self._bases:
            if doubt := odometry_of(self._transforms, self.pose_frame, base).doubt:
                yield doubt


#: Numbers of a scan that are float32 in the message.
_GEOMETRY = ("angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")

_WORD = re.compile(r"[!-~]+")

#: Fields with the strength of a return, the best one first.
_INTENSITIES = ("intensity", "intensities", "i", "reflectivity", "reflectance")


def lines_file(path: Path) -> IO[str]:
    """Create a text file."""
    return path.open("x", encoding="utf-8", errors="surrogateescape", newline="\n")


def _csv_cell(text: str) -> str:
    r"""Return text as a cell of a CSV file: visible, in quotes if necessary, and never a formula.

    Spreadsheets compute a cell that begins with ``=``, ``+``, ``-`` or ``@``, and names come from untrusted recordings.
    No frame or topic of ROS begins with one of these, so the character is escaped like a control character.

    >>> print(_csv_cell("base_link"), _csv_cell("a,b"), _csv_cell("=cmd|' /C calc'!A0"))
    base_link "a,b" \x3dcmd|' /C calc'!A0
    """
    if text[:1] in ("=", "+", "-", "@"):
        text = f"\\x{ord(text[0]):02x}{text[1:]}"
    text = visible(text, None)
    return '"' + text.replace('"', '""') + '"' if "," in text or '"' in text else text


def _texts(values: ArrayLike) -> list[str]:
    """Return the shortest texts that float32 reads back as these values: ``nan``, ``inf``, ``1.5707964``."""
    return list(map(str, np.atleast_1d(np.asarray(values, np.float32))))


def _planar(rigid: Rigid) -> Sequence[float]:
    """Return x, y and yaw of a pose: metres and radians."""
    x, y, _ = rigid.translation.tolist()
    return x, y, rigid.rpy[2]


def _has_intensities(scan: Scan) -> bool:
    return len(scan.intensities) == len(scan.ranges) > 0


def _refuse_other_beams(scan: Scan, first: Scan, what: str, *, angles: bool) -> None:
    """Raise if a scan has other beams than the first, or if only one of the two has intensities."""
    layouts = []
    for beams in (scan, first):
        text = f"{len(beams.ranges)} beams {'with' if _has_intensities(beams) else 'without'} intensities"
        angle = f" from {beams.angle_min:.9g} rad on, {beams.angle_increment:.9g} rad apart" if angles else ""
        layouts.append(text + angle)
    if layouts[0] != layouts[1]:
        stamp = stamp_text(scan.stamp_ns)
        text = f"{what} needs scans with the same beams, but the scan at {stamp} has {layouts[0]}, and the first"
        hint = "`pc2scan convert` with `rebin` gives all scans the same beams; `start` and `end` export a part"
        raise UsageError(f"{text} {layouts[1]}", topic=scan.topic, hint=hint)


@contextmanager
def write_csv(path: Path) -> Iterator[Write]:
    """Write a row for each scan: stamps, pose, geometry, ``range_0`` and so on, ``intensity_0`` and so on.

    Numbers have the fewest digits from which float32 (for poses float64) reads the recorded value.
    """
    first: Scan | None = None
    with lines_file(path) as file:

        def write(scan: Scan, posed: MessagePoses | None) -> None:
            nonlocal first
            if first is None:
                first = scan
                beams = range(len(scan.ranges))
                names = ["stamp_ns", "log_time_ns", "frame", *(("x", "y", "yaw") if posed else ()), *_GEOMETRY]
                names += [f"range_{i}" for i in beams] + [f"intensity_{i}" for i in beams if _has_intensities(scan)]
                file.write(",".join(names) + "\n")
            _refuse_other_beams(scan, first, "a CSV file", angles=False)
            row = [str(scan.stamp_ns), str(scan.log_time_ns), _csv_cell(scan.frame)]
            row += map(repr, _planar(posed.robot) if posed else ())
            row += _texts([getattr(scan, name) for name in _GEOMETRY]) + _texts(scan.ranges)
            row += _texts(scan.intensities) if _has_intensities(scan) else ()
            file.write(",".join(row) + "\n")

        yield write


@contextmanager
def write_npz(path: Path) -> Iterator[Write]:
    """Write an archive: ``ranges`` (scans, beams), ``angles`` (beams,), ``stamps`` (scans,), ``poses`` (scans, 3), ...

    The number of scans, which is at the beginning of each array, is known only at the end. So each array is collected
    in a temporary file. The archive is not compressed, and its bytes depend on the scans alone.
    """
    count = 0
    first: Scan | None = None
    row: dict[str, NDArray[Any]] = {}
    alone: dict[str, ArrayLike] = {}
    files: dict[str, IO[bytes]] = {}
    with ExitStack() as stack:

        def write(scan: Scan, posed: MessagePoses | None) -> None:
            nonlocal count, first, row
            row = {"ranges": np.asarray(scan.ranges, "<f4")}
            if _has_intensities(scan):
                row["intensities"] = np.asarray(scan.intensities, "<f4")
            row |= {"stamps": np.asarray(scan.stamp_ns, "<i8"), "log_times": np.asarray(scan.log_time_ns, "<i8")}
            if posed:
                row["poses"] = np.asarray(_planar(posed.robot), "<f8")
            for name in ("range_min", "range_max", "time_increment", "scan_time"):
                row[name] = np.asarray(getattr(scan, name), "<f4")
            if first is None:
                first = scan
                alone.update(angles=scan.angles, topic=scan.topic, frame=scan.frame)
                if posed:
                    alone.update(pose_frame=posed.pose_frame, base_frame=posed.base_frame)
                files.update({name: stack.enter_context(TemporaryFile(dir=path.parent)) for name in row})
            _refuse_other_beams(scan, first, "an .npz archive", angles=True)
            for name, values in row.items():
                files[name].write(values.tobytes())
            count += 1

        yield write
        with zipfile.ZipFile(path, "x") as archive:
            for name, values in (row | alone).items():
                # The earliest time of the format, so that the same scans give the same bytes.
                info = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
                with archive.open(info, "w", force_zip64=True) as member:
                    if name in alone:
                        np.lib.format.write_array(member, np.asarray(values), allow_pickle=False)
                        continue
                    shape = (count, *row[name].shape)
                    header = {"descr": row[name].dtype.str, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(member, header)
                    files[name].seek(0)
                    shutil.copyfileobj(files[name], member)


@contextmanager
def write_tum(path: Path) -> Iterator[Write]:
    """Write a line for each scan, as evo reads it: ``timestamp x y z qx qy qz qw``, seconds and metres."""
    last_ns: int | None = None
    with lines_file(path) as file:

        def write(scan: Scan, posed: MessagePoses | None) -> None:
            nonlocal last_ns
            assert posed is not None
            if last_ns is not None and scan.stamp_ns <= last_ns:
                raise UnwritableError(f"its stamp is not later than the one before, {stamp_text(last_ns)}")
            last_ns = scan.stamp_ns
            file.write(" ".join((stamp_text(scan.stamp_ns), *map(repr, posed.robot.pose))) + "\n")

        yield write


@contextmanager
def write_pcd(path: Path) -> Iterator[Write]:
    """Write a binary .pcd for each cloud, named after its stamp in nanoseconds, with its own fields.

    Source of the rules: "The PCD (Point Cloud Data) file format", version 0.7, of PCL's documentation.
    """
    path.mkdir()
    stamps: Counter[int] = Counter()

    def write(cloud: Cloud, posed: MessagePoses | None) -> None:
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

        def write(cloud: Cloud, posed: MessagePoses | None) -> None:
            name = next((field for field in _INTENSITIES if field in cloud.fields), None)
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


class FileWriter(NamedTuple):
    """A format of export.

    Attributes
    ----------
    name
        The name that users type.
    suffix
        The suffix of its files.
    open
        Begins to write a topic at a path that does not exist. The function that it yields raises a `MessageError` if a
        message cannot be written, but others can, and a `UsageError` if the format cannot store the topic.
    needs_poses
        Whether it cannot be written without poses.
    clouds
        Whether it stores clouds, each in a file of a folder; otherwise scans, in one file.
    """

    name: str
    suffix: str
    open: Callable[[Path], AbstractContextManager[Write]]
    needs_poses: bool = False
    clouds: bool = False


#: The formats by name.
FORMATS = {
    "npz": FileWriter("npz", ".npz", write_npz),
    "csv": FileWriter("csv", ".csv", write_csv),
    "tum": FileWriter("tum", ".tum", write_tum, needs_poses=True),
    "pcd": FileWriter("pcd", ".pcd", write_pcd, clouds=True),
    "kitti": FileWriter("kitti", ".bin", write_kitti, clouds=True),
}


def format_of(name: str | None, destination: Path) -> FileWriter:
    """Return the format with a name, or if there is none, the format of a file's suffix.

    Raises
    ------
    UsageError
        If no format has the suffix, or another one than that with the name.
    """
    by_suffix = next(
        (file_format for file_format in FORMATS.values() if file_format.suffix == destination.suffix.lower()), None
    )
    if name is not None:
        if by_suffix is not None and by_suffix.name != name and not FORMATS[name].clouds:
            raise UsageError(f"`format` is {name}, but this is the name of {by_suffix.name}", path=destination)
        return FORMATS[name]
    if by_suffix is None or by_suffix.clouds:
        hint = f"give `format`: {', '.join(FORMATS)}; clouds are files in a folder"
        raise UsageError("no format has this suffix", path=destination, hint=hint)
    return by_suffix
