from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest
import typer

from pc2scan.cli import app as app_module
from pc2scan.cli.in_process import run_command
from pc2scan.errors import UsageError
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"


def test_what_is_said_is_returned_and_not_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    ended = run_command(["convert", str(HALL), "-o", str(tmp_path / "out.bag")])
    assert ended.status == 0
    assert "min_height" in ended.messages
    again = run_command(["convert", str(HALL), "-o", str(tmp_path / "out.bag")])
    assert again.status == 2
    assert "--overwrite" in again.messages
    assert run_command(["convert"]).status == 2
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("chosen", [["-o", "out.bag"], ["--output=out.bag"]])
def test_where_the_output_goes_is_not_chosen_by_a_case(chosen: list[str], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--output may not be in a case"):
        run_command(["convert", str(HALL), "-o", str(tmp_path / "actual.bag")], chosen)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)], ids=str
)
def test_a_signal_is_meant_for_the_whole_process(
    number: signal.Signals, raised: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    app = typer.Typer()

    @app.command()
    def ended() -> None:
        raise SystemExit(128 + number)

    monkeypatch.setattr(app_module, "application", lambda *_: app)
    with pytest.raises(raised):
        run_command([])
