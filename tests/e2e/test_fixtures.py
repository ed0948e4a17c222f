from __future__ import annotations

import importlib.util
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.bags.opening import open_recording
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

FIXTURES = ROOT / "fixtures"


def content(path: Path) -> list[tuple[Any, ...]]:
    """Compressed bytes depend on the versions of libraries; what is in a recording does not."""
    with closing(open_recording(path)) as reader:
        return [
            (m.connection.topic, m.connection.msgtype, m.connection.qos, m.log_time_ns, bytes(m.data))
            for m in reader.messages()
        ]


@pytest.mark.parametrize("name", ["hall.bag", "hall.mcap", "hall"])
def test_the_script_makes_the_fixtures(tmp_path: Path, name: str) -> None:
    spec = importlib.util.spec_from_file_location("make_fixtures", FIXTURES / "make_fixtures.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.make(tmp_path / name)
    assert content(tmp_path / name) == content(FIXTURES / name)
