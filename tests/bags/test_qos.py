"""QoS profiles: what they say, and how they are spelled."""

from __future__ import annotations

import pytest

from pc2scan.bags.qos import respell_qos
from pc2scan.bags.topics import latches
from support.mcap_files import QOS
from support.rosbag2_files import QOS_NAMES, QOS_NUMBERS


@pytest.mark.parametrize(
    ("qos", "expected"),
    [
        ("", False),
        (QOS, True),
        ("- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 1", False),
        ("- durability: volatile\n- durability: transient_local\n", True),
        ("- durability: transient_local_ish", False),
        ("- durability: 10", False),
        ("- {history: 1, durability: 1}", True),
        ('- {"durability": "transient_local"}', True),
        ("- durability:\n  depth: 1", False),
        ("- some_durability: 1", False),
        ("- reliability: 1", False),
        ("durability: TRANSIENT_LOCAL", True),
    ],
)
def test_latches(qos: str, *, expected: bool) -> None:
    assert latches(qos) is expected


def test_respelling_profiles() -> None:
    assert respell_qos(QOS_NAMES) == QOS_NUMBERS
    verbatim = f"# as it was\n{QOS_NUMBERS}"
    assert respell_qos(verbatim) == verbatim
    assert respell_qos("") == ""
    odd = "- history: 99\n  reliability: sometimes\n  durability: true\n  liveliness: null\n  speed: 3"
    assert respell_qos(odd).startswith(odd)
    assert respell_qos("- reliability: Best_Effort").startswith("- reliability: 2\n")
