"""A pytest plugin: golden cases as tests, and fixtures that compare recordings.

``pytest --pc2scan-golden DIR`` runs the cases of a folder together with the other tests; with the ini option
``pc2scan_golden`` they run whenever pytest collects the folder. Without a folder the hooks do nothing. Modules are
imported by the first test that uses them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from os import PathLike

__all__ = ["assert_same_scans", "pc2scan_golden"]

_FOLDERS = pytest.StashKey[frozenset[Path]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the options."""
    group = parser.getgroup("pc2scan")
    group.addoption(
        "--pc2scan-golden",
        action="append",
        default=[],
        metavar="DIR",
        help="Also run the golden cases of this folder. Repeatable.",
    )
    group.addoption(
        "--pc2scan-update",
        action="store_true",
        help="Write the expected output of golden cases that differ or have none.",
    )
    parser.addini("pc2scan_golden", "Folders of golden cases, run when pytest collects them.", type="paths", default=[])


def pytest_configure(config: pytest.Config) -> None:
    """Store the folders; those of the command line are always collected."""
    typed = [(config.invocation_params.dir / folder).resolve() for folder in config.getoption("--pc2scan-golden")]
    folders = frozenset((*typed, *(folder.resolve() for folder in config.getini("pc2scan_golden"))))
    config.stash[_FOLDERS] = folders
    # Workers of pytest-xdist get arguments that include the folders already.
    config.args += [str(folder) for folder in typed if str(folder) not in config.args]


# Optional: older versions of pytest do not have this hook.
@pytest.hookimpl(tryfirst=True, optionalhook=True)
def pytest_collect_directory(path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect the folders of golden cases; pytest collects all others."""
    folders = parent.config.stash[_FOLDERS]
    resolved = path.resolve() if folders else path
    if not any(folder == resolved or folder in resolved.parents for folder in folders):
        return None
    from .collect import GoldenFolder  # noqa: PLC0415 - heavy

    folder: pytest.Collector = GoldenFolder.from_parent(parent, path=path)
    return folder


@pytest.fixture(scope="session")
def assert_same_scans() -> Callable[..., None]:
    """Compare two recordings with the options of `pc2scan.diff`: ``assert_same_scans(expected, actual, rtol=1e-5)``."""

    def assert_same(
        expected: str | PathLike[str],
        actual: str | PathLike[str],
        *,
        atol: float | Mapping[str, float] = 0.0,
        rtol: float | Mapping[str, float] = 0.0,
        **rules: Any,
    ) -> None:
        __tracebackhide__ = True
        from pc2scan import diff  # noqa: PLC0415

        difference = diff(expected, actual, atol=atol, rtol=rtol, **rules)
        if not difference.same:
            pytest.fail(difference.text(("expected", "actual")), pytrace=False)

    return assert_same


@pytest.fixture(scope="session")
def pc2scan_golden(request: pytest.FixtureRequest) -> Callable[[str | PathLike[str]], None]:
    """Check one golden case: ``pc2scan_golden("golden/hall")``."""

    def check(folder: str | PathLike[str]) -> None:
        __tracebackhide__ = True
        from .collect import check  # noqa: PLC0415

        check(Path(folder), request.config)

    return check
