"""What tests of parameters and their files share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import pytest
from hypothesis import strategies as st

from pc2scan.errors import ParameterError
from pc2scan.pipeline.parameters import resolve

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.core.params import ProjectionParams
    from pc2scan.pipeline.params_file import ParamsFile


class Load(Protocol):
    """The fixture `load`: writes a file and loads it."""

    def __call__(self, text: str | bytes, *, node: str | None = None) -> ParamsFile: ...


def values(file: ParamsFile) -> dict[str, object]:
    return {setting.name: setting.value for setting in file.settings}


def params_of(file: ParamsFile) -> ProjectionParams:
    return resolve(file.settings, direction=file.direction or "pointcloud_to_laserscan").params


def failure(call: Callable[[], object]) -> ParameterError:
    with pytest.raises(ParameterError) as caught:
        call()
    return caught.value


def ros2(parameters: dict[str, object], node: str = "pointcloud_to_laserscan") -> str:
    lines = [f"    {name}: {value}" for name, value in parameters.items()]
    return "\n".join([f"{node}:", "  ros__parameters:", *lines, ""])


YAML_PIECES = [
    "range_min",
    "ros__parameters",
    "use_inf",
    "<<",
    "/**",
    "a",
    "~",
    "1",
    "1.5",
    ".nan",
    "deg(1)",
    "!!int",
    "!x",
    ": ",
    ":",
    "- ",
    "\n",
    "  ",
    "\t",
    "{",
    "}",
    "[",
    "]",
    ", ",
    "&a ",
    "*a",
    "'",
    '"',
    "# ",
    "? ",
    "%",
    "---\n",
    ">\n",
]


yaml_like = st.lists(st.sampled_from(YAML_PIECES), max_size=30).map("".join)
