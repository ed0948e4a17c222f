"""Percentiles and medians are NumPy's, to the bit."""

from __future__ import annotations

import statistics

import numpy as np
import pytest

from pc2scan.core.percentiles import median, median_low, percentiles


@pytest.mark.parametrize("count", [1, 2, 3, 10, 997])
def test_they_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    asked = (0, 0.5, 5, 10, 50, 95, 99.5, 100)
    assert percentiles(values, *asked) == tuple(np.percentile(values, asked).tolist())
    assert median(values) == np.median(values)
    assert median_low(values.tolist()) == statistics.median_low(values)


def test_values_of_any_shape() -> None:
    assert percentiles([[4.0, 1.0], [2.0, 3.0]], 50) == (2.5,)
