"""The filters that options ask for."""

from __future__ import annotations

from typing import Any

import pytest

from pc2scan.options.table import options_of
from pc2scan.request.filters import filters_of

#: Values of each option.
VALUES: dict[str, Any] = {
    "where": ["ring in (3, 4)", "intensity > 10"],
    "exclude_box": ["base_link -0.5 0.5 -inf inf 0 1"],
    "exclude_polygon": ["base_link 0 0 1 0 1.5 1"],
    "ground": "remove",
    "min_height_slope": 0.05,
}


@pytest.mark.parametrize("name", VALUES)
def test_the_text_of_a_filter_asks_for_the_same_filter(name: str) -> None:
    kind = options_of("convert")[name].value
    made = tuple(filters_of({name: VALUES[name]}, -0.3))
    assert {each.name for each in made} == {name}
    texts: list[str] = [each.text for each in made]  # type: ignore[attr-defined]
    again = texts if kind.repeats else float(texts[0]) if kind.kind == "float" else texts[0]
    assert tuple(filters_of({name: again}, -0.3)) == made
