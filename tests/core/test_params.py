from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan import ProjectionParams
from pc2scan.core.layout import beam_count
from pc2scan.errors import ParameterError
from support.tables import rows

TABLES = Path(__file__).with_name("params.txt")


@pytest.mark.parametrize(("low", "high", "increment", "count"), rows(TABLES, "numbers of beams"))
def test_beam_count(low: float, high: float, increment: float, count: int) -> None:
    assert beam_count(low, high, increment) == count


@pytest.mark.parametrize(("named", "values"), rows(TABLES, "values that cannot be"))
def test_values_that_cannot_be_are_refused_by_name(named: str, values: dict[str, Any]) -> None:
    with pytest.raises(ParameterError) as caught:
        ProjectionParams(**values)
    assert caught.value.name == named
    assert named in caught.value.message


def test_numpys_numbers_are_taken_as_pythons() -> None:
    """Compared with the default of the other limit, a float32 would overflow; warnings are errors here."""
    values: dict[str, Any] = {
        "min_height": np.float32(-1), "max_height": np.float16(2), "range_max": np.float32(30),
        "range_min": np.int64(1), "beams": np.uint16(90), "use_inf": np.bool_(False),
        "target_frame": np.str_("base_link"),
    }  # fmt: skip
    params = ProjectionParams(**values)
    assert params == ProjectionParams(**{name: value.item() for name, value in values.items()})
    for name in values:
        assert type(getattr(params, name)) is type(getattr(ProjectionParams(), name))
    with pytest.raises(ParameterError, match="min_height is NaN"):
        ProjectionParams(min_height=np.float32("nan"))  # type: ignore[arg-type]


@pytest.mark.parametrize(("values", "expected"), rows(TABLES, "empty beams"))
def test_what_an_empty_beam_reads(values: dict[str, float], expected: float) -> None:
    assert ProjectionParams(**values).empty_range == pytest.approx(expected, rel=0, abs=0, nan_ok=True)  # type: ignore[arg-type]


@pytest.mark.parametrize("geometry", ["upstream", "centered"])
@given(st.floats(-4, 0), st.floats(0.5, 7), st.integers(2, 20_000))
def test_a_number_of_beams_is_met(geometry: str, low: float, span: float, beams: int) -> None:
    params = ProjectionParams(geometry=geometry, angle_min=low, angle_max=low + span, beams=beams)
    assert params.length == beams
    # The increment that follows makes as many without being told the number.
    assert dataclasses.replace(params, beams=0).length == beams
    assert dataclasses.replace(params, range_max=5.0) == dataclasses.replace(params, range_max=5.0, angle_increment=1.0)
