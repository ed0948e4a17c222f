"""A real browser: the distribution's Chromium, driven by Playwright."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

needs_chromium = pytest.mark.skipif(
    CHROMIUM is None or find_spec("playwright") is None, reason="needs Chromium, and playwright from PyPI"
)

# Nothing that Chromium does by itself may look like a request of the page.
_FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


class Tab:
    """A page in the browser, and everything that it complained about or asked for."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.complaints: list[str] = []
        self.requests: list[str] = []
        page.on("console", lambda told: self.complaints.append(told.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def open(self, path: Path) -> None:
        """Open a file as a double click does, and wait until it is drawn."""
        self.page.add_init_script(
            "document.addEventListener('securitypolicyviolation', (e) => console.error('CSP ' + e.violatedDirective))"
        )
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("body[data-drawn]", state="attached")

    def call(self, code: str, argument: Any = None) -> Any:
        """Run JavaScript in the page."""
        return self.page.evaluate(code, argument)

    def assert_quiet(self) -> None:
        """Nothing went wrong, and nothing but the file itself was asked for."""
        assert self.complaints == []
        assert [url for url in self.requests if not url.startswith(("file:", "data:"))] == []
        assert sum(url.startswith("file:") for url in self.requests) == 1


@contextmanager
def chromium() -> Iterator[Any]:
    """Start the browser; call the result with a viewport and a theme to open a `Tab`."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(_FLAGS))

        def tab(width: int = 1440, height: int = 900, theme: Literal["light", "dark"] = "light") -> Tab:
            return Tab(browser.new_page(viewport={"width": width, "height": height}, color_scheme=theme))

        try:
            yield tab
        finally:
            browser.close()
