"""A real browser: Debian's chromium, driven by playwright."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests import tools

READY_MS = 60_000


class Tab:
    """One page, and all that it did which nobody may do: faults, requests, dialogs."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.faults: list[str] = []
        self.asked: list[str] = []
        page.on("console", lambda said: self._said(said.type, said.text))
        page.on("pageerror", lambda error: self.faults.append(f"error: {error}"))
        page.on("request", lambda request: self.asked.append(request.url))
        page.on("dialog", self._dialog)

    def _said(self, kind: str, text: str) -> None:
        if kind in ("error", "warning"):
            self.faults.append(f"{kind}: {text}")

    def _dialog(self, dialog: Any) -> None:
        self.faults.append(f"dialog: {dialog.message}")
        dialog.dismiss()

    def open(self, file: Path) -> Any:
        """Go to a page on the disk and wait until its script has done its work."""
        self.asked.clear()
        self.page.goto(file.absolute().as_uri())
        self.page.wait_for_selector("body[data-ready=yes]", timeout=READY_MS)
        return self.page


@contextmanager
def launched() -> Iterator[Any]:
    """A browser, to open profiles in. Skips the test where there is none."""
    program = tools.program("chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=program, headless=True)
        try:
            yield chromium
        finally:
            chromium.close()
    # Playwright leaves streams of its own open, of which Python warns when it finds them.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


@contextmanager
def browser() -> Iterator[Tab]:
    """A tab of a browser that cannot reach anything. Skips the test where there is no browser."""
    with launched() as chromium:
        context = chromium.new_context(offline=True, viewport={"width": 1100, "height": 800})
        yield Tab(context.new_page())
