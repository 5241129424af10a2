"""docs/report.png: the page of the demo's run, in a browser. Run by hand after `make demo`:

python -m tests.bench.report_picture demo/captures/* docs/report.png
"""

from __future__ import annotations

import sys
from pathlib import Path

from pdcd.pages.report import write_report
from tests.browser import browser

WIDTH_PX, HEIGHT_PX = 1000, 1680


def main(folder: Path, out: Path) -> None:
    """Photograph the upper part of the page, with a cell clicked."""
    with browser() as tab:
        tab.page.set_viewport_size({"width": WIDTH_PX, "height": HEIGHT_PX})
        page = tab.open(write_report(folder))
        stage = page.locator("#stage").bounding_box()
        at = stage["x"] + 0.3 * stage["width"], stage["y"] + 0.4 * stage["height"]
        page.mouse.move(*at)
        page.mouse.click(*at)
        page.wait_for_timeout(300)
        clip = {"x": 0, "y": 0, "width": WIDTH_PX, "height": HEIGHT_PX}
        page.screenshot(path=str(out), full_page=True, clip=clip)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
