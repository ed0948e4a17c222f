"""Conversions by the real command, and what they made: scans, transforms and a report."""

from __future__ import annotations

import json
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.opening import open_recording
from pc2scan.conversion.steps import ScanToCloud, serialised
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan, encode_laserscan
from pc2scan.messages.pointcloud2 import POINTCLOUD2, encode_cloud
from pc2scan.messages.tfmessage import decode_transforms
from support.command import Finished, run

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pc2scan.conversion.steps import Conversion


def serialized_by(conversion: Conversion, topic: str, source: str, target: str) -> Callable[[bytes], Any]:
    """Return what makes serialised messages of serialised messages, each with what is counted of it."""
    reverses = isinstance(conversion, ScanToCloud)
    decode = SCANS[LASERSCAN](source, "first") if reverses else CLOUDS[POINTCLOUD2](source)
    encode = partial(serialised, encode_cloud if reverses else encode_laserscan, target)
    return lambda message: encode(stepped(conversion, topic, decode(message)))


def stepped(conversion: Conversion, topic: str, decoded: Any) -> Any:
    """Do all steps with a decoded message."""
    for step in filter(None, conversion.steps(topic)):
        decoded = step(decoded)
    return decoded


class Made(NamedTuple):
    """How a conversion ended, its scans and the transforms on /tf with their log times, and its report."""

    done: Finished
    timed: list[tuple[int, LaserScan]]
    transforms: list[tuple[int, Any]]
    report: dict[str, Any]

    @property
    def scans(self) -> list[LaserScan]:
        """The scans without their log times."""
        return [scan for _, scan in self.timed]

    @property
    def stdout(self) -> str:
        """What was printed, on one line."""
        return " ".join(self.done.stdout.split())

    @property
    def stderr(self) -> str:
        """What was said, on one line."""
        return " ".join(self.done.stderr.split())

    def topic(self, name: str) -> dict[str, Any]:
        """The report's entry of a source topic."""
        (entry,) = (each for each in self.report["topics"] if each["topic"] == name)
        return dict(entry)


def converted(destination: Path, *words: str | Path) -> Made:
    """Convert; the destination is replaced, and a report is written beside it."""
    report = destination.with_name("report.json")
    done = run("convert", *words, "-o", destination, "--overwrite", "--report", report)
    scans, transforms = [], []
    if destination.exists():
        with closing(open_recording(destination)) as reader:
            for message in reader.messages():
                topic, kind, form = (
                    getattr(message.connection, name) for name in ("topic", "ros_type", "serialization")
                )
                if kind.endswith("LaserScan"):
                    scans.append((message.log_time_ns, decode_laserscan(message.data, form)))
                elif topic == "/tf":
                    transforms += [(message.log_time_ns, row) for row in decode_transforms(message.data, form)]
    return Made(done, scans, transforms, json.loads(report.read_text()) if report.exists() else {})
