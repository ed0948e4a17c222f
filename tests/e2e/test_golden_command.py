"""What a golden case may not do; `tests/transcripts/golden.txt` has how cases are made, checked and updated."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import pytest

import pc2scan
from pc2scan.cli.in_process import run_command
from support import HALL
from support.command import run
from support.tables import rows

REFUSED: dict[str, str] = dict(rows(Path(__file__).with_name("golden_command.txt"), "arguments that no case may have"))


@pytest.mark.parametrize("status", [0, 2])
@pytest.mark.parametrize("update", [False, True])
def test_a_case_does_not_choose_where_anything_is_written(status: int, update: bool, tmp_path: Path) -> None:
    out = tmp_path / "OUT"
    out.write_text("years of work")
    shutil.copy(HALL, tmp_path / "hall.bag")
    for number, arguments in enumerate(REFUSED):
        case = tmp_path / "cases" / f"{number:02d}"
        case.mkdir(parents=True)
        settings = f"input: ../../hall.bag\narguments: {arguments.replace('OUT', str(out))}\nexit_status: {status}\n"
        (case / "case.yaml").write_text(settings)
        (case / "expected.txt").write_text("reviewed")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    done = run("golden", tmp_path / "cases", "--json", *["--update"] * update)
    assert done.status == 2
    found = json.loads(done.stdout)["cases"]
    assert len(found) == len(REFUSED)
    for case, (arguments, named) in zip(found, REFUSED.items(), strict=True):
        assert case["outcome"] == "error", arguments
        assert f"{case['name']}/case.yaml: arguments: " in case["text"]
        assert named in case["text"]
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_case_is_made_from_python(tmp_path: Path) -> None:
    report = pc2scan.golden(tmp_path / "case", init=HALL, topics="/points", end=0.2)
    assert [case.outcome for case in report.cases] == ["passed"]
    with pytest.raises(pc2scan.Pc2ScanError, match="has no effect without `init`"):
        pc2scan.golden(tmp_path / "case", start=1)


@pytest.mark.parametrize(("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)])
def test_a_signal_is_meant_for_the_whole_process(
    number: signal.Signals, raised: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(_words: object) -> int:
        if number == signal.SIGTERM:
            raise SystemExit(128 + number)
        return 128 + number

    monkeypatch.setattr("pc2scan.cli.in_process.run", ended)
    with pytest.raises(raised):
        run_command([])
