from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pc2scan.cli.fitting import table_lines

CELLS = [
    ("topic", "type", "messages", "lost", "what"),
    (
        "/front/lidar/velodyne_points",
        "sensor_msgs/msg/PointCloud2",
        "12,000",
        "-",
        "converted with a remark of some words",
    ),
    ("/imu", "sensor_msgs/msg/Imu", "7", "-", ""),
]
LEFT = ("topic", "type", "what")


def lines(width: int | None) -> list[str]:
    return list(table_lines(CELLS, LEFT, width))


def test_as_wide_as_it_is_where_there_is_room() -> None:
    assert len(lines(None)) == 4
    assert lines(None) == lines(200)
    assert "lost" in lines(None)[0]


def test_empty_columns_go_and_text_is_wrapped() -> None:
    shown = lines(80)
    assert max(map(len, shown)) <= 80
    assert "lost" not in shown[0]
    text = "".join("".join(line.split()) for line in shown)
    assert "12,000" in text
    # Nothing of the cells is missing.
    assert all(word in " ".join(shown) for word in ("/front/", "velodyne_points", "PointCloud2", "remark", "words"))
    assert shown[1] == "-" * len(shown[1])


def test_at_last_columns_on_the_right_go_and_are_named() -> None:
    shown = list(table_lines([["on", *"abcdefgh"], ["/scan", *["1,000,000"] * 8]], ("on",), 50))
    assert max(map(len, shown)) <= 50
    assert shown[-1] == "(no room for: e, f, g, h)"


@given(st.lists(st.lists(st.text("ab /", max_size=40), min_size=4, max_size=4), max_size=5), st.integers(60, 120))
def test_any_table_fits(rows: list[list[str]], width: int) -> None:
    cells = [["one", "two", "three", "four"], *rows]
    assert all(len(line) <= width for line in table_lines(cells, ("one", "three"), width))
