"""The table of filters that options ask for."""

from __future__ import annotations

from typing import Any

import pytest

from pc2scan.errors import UsageError
from pc2scan.pipeline.stages.filter_options import FILTER_OPTIONS, filters_from

#: Values of each option.
VALUES: dict[str, Any] = {
    "where": ["ring in (3, 4)", "intensity > 10"],
    "exclude_box": ["base_link -0.5 0.5 -inf inf 0 1"],
    "exclude_polygon": ["base_link 0 0 1 0 1.5 1"],
    "ground": "remove",
    "min_height_slope": 0.05,
}


@pytest.mark.parametrize("name", FILTER_OPTIONS)
def test_the_text_of_a_filter_asks_for_the_same_filter(name: str) -> None:
    option = FILTER_OPTIONS[name]
    made = tuple(option.filters(VALUES[name], -0.3))
    assert {each.name for each in made} == {name}
    texts: list[str] = [each.text for each in made]  # type: ignore[attr-defined]
    (first, *_) = texts
    again = {"texts": texts, "text": first, "number": first}[option.kind]
    assert tuple(option.filters(float(first) if option.kind == "number" else again, -0.3)) == made


def test_filters_are_applied_in_the_order_of_the_table() -> None:
    found = filters_from({"unknown": 1, **dict(reversed(VALUES.items()))}, -0.3)
    assert [each.name for each in found] == ["where", "where", *list(VALUES)[1:]]
    assert not list(filters_from({"ground": "keep"}, -0.3))
    with pytest.raises(UsageError, match="`exclude_box`"):
        list(filters_from({"exclude_box": ["base_link"]}, -0.3))
