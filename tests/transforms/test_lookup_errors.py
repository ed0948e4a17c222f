"""What a lookup says where there is no transform, and no command shows it: see tests/transcripts/transforms.txt."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.transforms.lookup_errors import MAX_NAMES
from transforms.small_buffers import at, built, refusal, row

if TYPE_CHECKING:
    from pc2scan.transforms.buffer import TransformBuffer

LOOP = built(static=[row(*pair, 0) for pair in (("a", "b"), ("b", "c"), ("c", "a"), ("c", "d"))])
#: At no time is there another parent.
EACH_OTHER = built([row(*pair, second) for second in (0, 1) for pair in (("a", "b"), ("b", "a"), ("b", "c"))])


@pytest.mark.parametrize(
    ("buffer", "names", "second", "told"),
    [
        (built(), "a b", 1, "there are no transforms"),
        (
            built([row("odom", "base", 0), row("base", "lidar", 0, norm=0)]), "odom lidar", 0,
            "; [lidar] in [base] was rejected: TF_DENORMALIZED_QUATERNION: the quaternion is zero",
        ),
        (
            built([row("odom", "base", 1)]), "odom base", 2,
            "not known at 1700000002.000000000: [base] in [odom] is known only at 1700000001.000000000",
        ),
        # Of several frames the farthest is named.
        (built([row("a", "b", 5), row("b", "c", 1), row("c", "d", 3)]), "a d", 6, "[c] in [b] is known"),
        (EACH_OTHER, "c b", 0.5, "[b] in [a] in [b]"),
        *((LOOP, names, 0, "contains a loop") for names in ("d a", "d b", "d c")),
    ],
)  # fmt: skip
def test_what_a_refusal_says(buffer: TransformBuffer, names: str, second: float, told: str) -> None:
    target, source = names.split()
    error = refusal(buffer, target, source, at(second))
    assert told in error.message
    assert error.stamp_ns == at(second)
    if buffer is LOOP:
        assert told in refusal(buffer, target, source, 0).message


def test_names_are_not_endless() -> None:
    message = refusal(built(static=[row("base", f"f{n:03}", 0) for n in range(100)]), "base", "x", at(1)).message
    assert message.count(",") == MAX_NAMES - 1
    assert message.endswith("f018 and 81 more")
