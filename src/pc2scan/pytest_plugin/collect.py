"""Golden cases as pytest's collectors and items."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from pc2scan.cli.in_process import run_command
from pc2scan.compare.golden.case import is_case
from pc2scan.compare.golden.check import check_case
from pc2scan.errors import visible

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pc2scan.compare.golden.check import CaseResult


def check(folder: Path, *, update: bool) -> CaseResult:
    """Check one case."""
    return check_case(folder.resolve().name, folder, run_command, update=update)


def make_collector(path: Path, parent: pytest.Collector) -> GoldenFolder | GoldenCase:
    """Make the node of a folder of cases, or of a case."""
    kind = GoldenCase if is_case(path) else GoldenFolder
    node: GoldenFolder | GoldenCase = kind.from_parent(parent, path=path)
    return node


class GoldenFolder(pytest.Directory):
    """A folder with cases in it."""

    def collect(self) -> Iterator[pytest.Item | pytest.Collector]:
        """Yield its cases, and the folders that may contain cases."""
        for path in sorted(self.path.iterdir()):
            if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
                yield make_collector(path, self)


class GoldenCase(pytest.Directory):
    """A case."""

    def collect(self) -> Iterator[pytest.Item]:
        """Yield its only test. The id is the folder, so that an id which pytest prints can be given to pytest."""
        yield GoldenItem.from_parent(self, name=self.name, nodeid=self.nodeid)


class GoldenItem(pytest.Item):
    """The test of a case: its conversion writes the expected output."""

    def runtest(self) -> None:
        """Convert and compare."""
        result = check(self.path, update=bool(self.config.getoption("--pc2scan-update")))
        if result.outcome in ("failed", "error"):
            raise _CaseFailure("\n".join(result.lines))
        if result.lines:
            self.add_report_section("call", "pc2scan", "\n".join((result.outcome.value, *result.lines)))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Show the differences without a traceback."""
        if isinstance(excinfo.value, _CaseFailure):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Name the case."""
        return self.path, None, visible(f"golden case {self.path.name}")


class _CaseFailure(Exception):  # noqa: N818 - a failure of a test, not an error
    """The output differs from the expected one, or could not be checked."""
