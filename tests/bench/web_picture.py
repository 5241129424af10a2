"""docs/web.jpg: the page of `pdcd web` before a mock bench, in a browser. Run by hand:

python -m tests.bench.web_picture docs/web.jpg
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from pdcd.bench.tables import CameraConfig, Config, ServerConfig
from pdcd.panels.placing import Placing
from tests import world
from tests.browser import READY_MS, launched
from tests.e2e.web._bench import bench

WIDTH_PX, QUALITY = 1180, 85
PHOTOS = (("white", "", "empty shelf"), ("indirect", "open book", "lamp warm, room dark"))
"""Goal, name and note of the photos that are listed; the last one is the picture."""


def main(out: Path) -> None:
    """Take the photos, begin a live view, and photograph the page."""
    world.enter()
    with tempfile.TemporaryDirectory(prefix="pdcd-page-") as scratch:
        place = Placing(turn_deg=2.0, scale=1.08)
        config = Config(
            camera=CameraConfig(quads_per_cell=6, place=place),
            server=ServerConfig(state_dir=f"{scratch}/state"),
        )
        with launched() as chromium, bench(Path(scratch), config) as here:
            page = chromium.new_page(viewport={"width": WIDTH_PX, "height": 900})
            page.set_default_timeout(10 * READY_MS)
            page.goto(here.address)
            for goal, name, note in PHOTOS:
                page.locator("#start:enabled").wait_for()
                page.select_option("#field-goal", goal)
                page.fill("#field-codes", "128")
                page.fill("#field-name", name)
                page.fill("#field-note", note)
                page.click("#start")
                page.locator(f"#picture[alt^='{goal} of ']").wait_for()
            page.locator("#live:enabled").click()
            page.locator("#live-figures dd", has_text="pictures a second").wait_for()
            page.wait_for_timeout(3000)
            page.screenshot(path=str(out), full_page=True, type="jpeg", quality=QUALITY)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
