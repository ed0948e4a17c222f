"""What tests of parameters and their files share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import strategies as st

from pc2scan.errors import ParameterError
from pc2scan.request.parameters import resolve

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.core.params import ProjectionParams
    from pc2scan.request.params_file import ParamsFile


def params_of(file: ParamsFile) -> ProjectionParams:
    return resolve(file.settings, direction=file.direction or "pointcloud_to_laserscan").params


def failure(call: Callable[..., object], *args: object, **options: object) -> ParameterError:
    with pytest.raises(ParameterError) as caught:
        call(*args, **options)
    return caught.value


_YAML_PIECES = (
    *("range_min", "ros__parameters", "use_inf", "<<", "/**", "a", "~", "1", "1.5", ".nan", "deg(1)", "!!int", "!x"),
    *(
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
    ),
)
yaml_like = st.lists(st.sampled_from(_YAML_PIECES), max_size=30).map("".join)
