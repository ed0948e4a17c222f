"""Measures how long a page of ``pc2scan view`` takes to redraw while a slider moves, in headless Chromium.

By hand::

    pc2scan view drive.bag -o page.html --clouds 1
    python tests/benchmarks/page.py page.html

Needs playwright, and Chromium at /usr/bin/chromium. The mouse drags each slider for four seconds, a step every 25 ms.
``painted`` is the time from an input event until the frame with it is on the screen, ``own code`` the part of it that
the page's code takes. Several pages are measured one after the other, so that two versions can be compared.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

SLIDERS = ("max_height", "range_max", "mount-z", "mount-roll", "mount-yaw")
STEPS = 150

#: Records each redraw: the page's own work, and the time until the message that follows the frame.
RECORDER = """
window.times = {painted: [], "own code": []};
let begun = 0, work = 0, input = 0;
const nextFrame = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => nextFrame((time) => {
  const start = performance.now();
  draw(time);
  work += performance.now() - start;
  if (!begun) return;
  const [first, own] = [begun, work];
  begun = work = 0;
  const channel = new MessageChannel();
  channel.port1.onmessage = () => {
    times.painted.push(performance.now() - first);
    times["own code"].push(own);
  };
  channel.port2.postMessage(0);
});
window.addEventListener("input", () => { input = performance.now(); begun = begun || input; }, true);
document.addEventListener("DOMContentLoaded", () => {
  window.addEventListener("input", () => { work += performance.now() - input; });
});
"""


def main(pages: list[Path]) -> None:
    """Print median and 95 % of each page and slider, ms."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox", "--disable-gpu"]
        )
        for path in pages:
            for slider in SLIDERS:
                page = browser.new_page(viewport={"width": 1440, "height": 900})
                page.add_init_script(RECORDER)
                page.goto(path.resolve().as_uri())
                page.wait_for_selector("body[data-drawn]", state="attached")
                handle = page.locator(f"#param-{slider}, #{slider}").locator('xpath=../input[@type="range"]')
                handle.scroll_into_view_if_needed()
                box = handle.bounding_box()
                assert box is not None, slider
                middle = box["y"] + box["height"] / 2
                page.mouse.move(box["x"] + box["width"] / 2, middle)
                page.mouse.down()
                for step in range(STEPS):
                    page.mouse.move(box["x"] + box["width"] * (0.5 + 0.3 * math.sin(step / 9)), middle)
                    page.wait_for_timeout(25)
                page.mouse.up()
                page.wait_for_timeout(300)
                for name, times in page.evaluate("window.times").items():
                    # The first frames load what is drawn.
                    found = sorted(times[5:])
                    middle_ms, high_ms = found[len(found) // 2], found[int(0.95 * len(found))]
                    print(f"{path.name:24} {slider:12} {name:10} {middle_ms:6.1f} {high_ms:6.1f}  n={len(found)}")  # noqa: T201
                page.close()
        browser.close()


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
