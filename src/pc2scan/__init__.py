"""Converts recorded 3D lidar to 2D laser scans, bit for bit what ROS's pointcloud_to_laserscan returns.

Recordings to recordings, in the words of the command line:

- `convert`: clouds to laser scans, or back; everything else passes through
- `batch`: every recording of a dataset, in processes; what is done is not done again
- `repair`: a sound recording from a damaged one
- `info`, `tf`, `check`: what is in a recording, its frames, and who would accept its scans
- `diff`, `golden`: what differs between two recordings, and whether conversions still make what they once made

Recordings to arrays:

- `scans`, `clouds`: the messages of a recording, one after the other; `scans` also converts clouds on the way
- `export`: scans with poses, trajectories and clouds as files that learning and evaluation read
- `project`: points to a scan, without a recording
- `view`: clouds and the scans that come of them, as a page
- `map`: scans in a map, where the recorded odometry places them
- `plot`: clouds and their scans as a figure

A recording is a ROS 1 bag, a rosbag2 directory, a ``.db3`` or an ``.mcap`` file, as ``str`` or ``pathlib.Path``, or a
list of several that are one. The parameters of the projection are `ProjectionParams`, or keywords of `convert` and
`scans`. Errors are those of `pc2scan.errors`, and begin at `Pc2ScanError`. ``print`` shows a result as tables.

``help(pc2scan.convert)`` explains one of them, and the notebook ``docs/python.ipynb`` shows most.

Importing this module is cheap: what it offers is loaded on first use.
"""

from __future__ import annotations

import sys
from importlib import import_module

from .version import __version__ as __version__

# A constant, as importing `typing` would take most of the time of importing this module.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from . import errors as errors
    from .api import batch as batch
    from .api import check as check
    from .api import clouds as clouds
    from .api import convert as convert
    from .api import diff as diff
    from .api import export as export
    from .api import golden as golden
    from .api import info as info
    from .api import map as map  # noqa: A004
    from .api import plot as plot
    from .api import repair as repair
    from .api import scans as scans
    from .api import tf as tf
    from .api import view as view
    from .compare.differences import Difference as Difference
    from .compare.golden import GoldenReport as GoldenReport
    from .conversion.report import Report as Report
    from .core.params import ProjectionParams as ProjectionParams
    from .core.project import ProjectedScan as ProjectedScan
    from .core.project import project as project
    from .core.rule import PointCounts as PointCounts
    from .core.unproject import UnprojectParams as UnprojectParams
    from .datasets.summary import BatchReport as BatchReport
    from .errors import Pc2ScanError as Pc2ScanError
    from .errors import RecordingWarning as RecordingWarning
    from .exports.export import ExportReport as ExportReport
    from .request.filters import ExcludeBox as ExcludeBox
    from .request.filters import ExcludePolygon as ExcludePolygon
    from .request.filters import MinHeightSlope as MinHeightSlope
    from .request.filters import Where as Where
    from .show.check import Check as Check
    from .show.info import Info as Info
    from .show.map import Map as Map
    from .show.plot import Plot as Plot
    from .show.tf import FrameTree as FrameTree
    from .show.view import Page as Page
    from .streams.objects import Cloud as Cloud
    from .streams.objects import Scan as Scan
    from .streams.stream import Clouds as Clouds
    from .streams.stream import Scans as Scans
    from .transforms.static import StaticTransform as StaticTransform

#: The public names, by the module that defines them.
_PUBLIC = {
    "api": (
        "batch",
        "check",
        "clouds",
        "convert",
        "diff",
        "export",
        "golden",
        "info",
        "map",
        "plot",
        "repair",
        "scans",
        "tf",
        "view",
    ),
    "compare.golden": ("GoldenReport",),
    "compare.differences": ("Difference",),
    "conversion.report": ("Report",),
    "core.params": ("ProjectionParams",),
    "core.project": ("ProjectedScan", "project"),
    "core.rule": ("PointCounts",),
    "core.unproject": ("UnprojectParams",),
    "datasets.summary": ("BatchReport",),
    "errors": ("Pc2ScanError", "RecordingWarning", "errors"),
    "exports.export": ("ExportReport",),
    "request.filters": ("ExcludeBox", "ExcludePolygon", "MinHeightSlope", "Where"),
    "show.check": ("Check",),
    "show.info": ("Info",),
    "show.map": ("Map",),
    "show.plot": ("Plot",),
    "show.tf": ("FrameTree",),
    "show.view": ("Page",),
    "streams.objects": ("Cloud", "Scan"),
    "streams.stream": ("Clouds", "Scans"),
    "transforms.static": ("StaticTransform",),
}
_HOMES = {name: home for home, names in _PUBLIC.items() for name in names}

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name, obj=sys.modules[__name__])
    module = import_module(f".{home}", __name__)
    value = module if home == name else getattr(module, name)
    # Where it is to be imported from, as help and representations show it.
    if home != name and value.__module__ == module.__name__:
        value.__module__ = __name__
    if name == "ProjectionParams":
        module.ProjectionParams.reader = staticmethod(_params_from_file)
    globals()[name] = value
    return value


def _params_from_file(*arguments: Any) -> Any:
    """Read a parameter file for `ProjectionParams.from_file`."""
    return import_module(".parsing", __name__).params_from_file(*arguments)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
