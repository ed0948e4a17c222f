"""Converts recorded 3D lidar to 2D laser scans, bit for bit what ROS's pointcloud_to_laserscan returns.

`convert` converts recordings, `project` converts points to a scan, `check` checks which consumers accept a recording's
scans, `info` describes a recording, `diff` compares two. Errors are those of `pc2scan.errors`.
Importing this module is cheap: its functions and classes are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module

from .version import __version__ as __version__

# A constant, as importing `typing` would take most of the time of importing this module.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from .api import convert as convert
    from .api import diff as diff
    from .compare.result import Difference as Difference
    from .core.counts import PointCounts as PointCounts
    from .core.params import ProjectionParams as ProjectionParams
    from .core.project import ProjectedScan as ProjectedScan
    from .core.project import project as project
    from .core.unproject import UnprojectParams as UnprojectParams
    from .inspect.check import check as check
    from .inspect.info import info as info
    from .pipeline.report import Report as Report
    from .tf.options import FrameOptions as FrameOptions
    from .tf.options import StaticTransform as StaticTransform

__all__ = [
    "Difference",
    "FrameOptions",
    "PointCounts",
    "ProjectedScan",
    "ProjectionParams",
    "Report",
    "StaticTransform",
    "UnprojectParams",
    "check",
    "convert",
    "diff",
    "info",
    "project",
]

_HOMES = {
    "Difference": "compare.result",
    "FrameOptions": "tf.options",
    "PointCounts": "core.counts",
    "ProjectedScan": "core.project",
    "ProjectionParams": "core.params",
    "Report": "pipeline.report",
    "StaticTransform": "tf.options",
    "UnprojectParams": "core.unproject",
    "check": "inspect.check",
    "convert": "api",
    "diff": "api",
    "info": "inspect.info",
    "project": "core.project",
}


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{home}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
