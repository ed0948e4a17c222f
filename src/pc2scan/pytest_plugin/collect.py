"""Golden cases as pytest's collectors and items."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pc2scan.cli.in_process import run_command
from pc2scan.compare.golden import check_case, is_case
from pc2scan.errors import visible

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pc2scan.compare.golden import CaseResult


def check(folder: Path, config: pytest.Config) -> CaseResult:
    """Check one case; the test fails if its output is not as expected, or could not be checked."""
    __tracebackhide__ = True
    update = bool(config.getoption("--pc2scan-update"))
    result = check_case(folder.resolve().name, folder, run_command, update=update)
    if result.outcome in ("failed", "error"):
        pytest.fail("\n".join((f"golden case {result.name}", *result.lines)), pytrace=False)
    return result


class GoldenFolder(pytest.Directory):
    """A case, or a folder with cases in it."""

    def collect(self) -> Iterator[pytest.Item | pytest.Collector]:
        """Yield the test of a case; for a folder, its cases and the folders that may contain cases."""
        if is_case(self.path):
            # The id is the folder, so that an id which pytest prints can be given to pytest.
            yield GoldenItem.from_parent(self, name=self.name, nodeid=self.nodeid)
            return
        for path in sorted(self.path.iterdir()):
            if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
                yield GoldenFolder.from_parent(self, path=path)


class GoldenItem(pytest.Item):
    """The test of a case: its conversion writes the expected output."""

    def runtest(self) -> None:
        """Convert and compare."""
        result = check(self.path, self.config)
        if result.lines:
            self.add_report_section("call", "pc2scan", "\n".join((result.outcome, *result.lines)))

    def reportinfo(self) -> tuple[Path, None, str]:
        """Name the case."""
        return self.path, None, visible(f"golden case {self.path.name}")
