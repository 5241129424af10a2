"""Limits of the page are those that its document tells."""

from __future__ import annotations

from typing import Any

from pdcd.web import app, asks, door, news, serve, shelf
from tests.places import ROOT

KIB, MIB = 2**10, 2**20


def documented() -> dict[str, str]:
    """The table of limits, by what is limited."""
    text = (ROOT / "docs" / "web.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return {row[0]: row[1] for row in rows if len(row) == 2}


def test_the_limits_are_those_of_the_document() -> None:
    told = documented()
    limits: Any = serve.SERVER_SETTINGS
    assert told["connections"].startswith(f"{door.STRANGERS} that have not shown")
    assert told["time of a request"] == (
        f"{door.STRANGER_S:g} s until it has shown the token, {door.REQUEST_S:g} s in all; "
        f"{app.LONG_S:g} s where the rig is asked"
    )
    assert told["head of a request"] == (
        f"{limits['max_headers']} lines of up to {limits['max_field_size'] / KIB:g} KiB, "
        f"the first {limits['max_line_size'] / KIB:g} KiB"
    )
    assert told["body of a request"] == (
        f"1 MiB less {(MIB - app.MOST_BODY_BYTES) / KIB:g} KiB for a photo, "
        f"{app.SMALL_BYTES / KIB:g} KiB else"
    )
    assert told["pages that receive news"] == str(news.PAGES)
    assert told["questions to the daemon"].startswith(f"{asks.AT_A_TIME} at a time, and one more")
    assert told["pictures, reports"].startswith(
        f"{shelf.MOST_PICTURE_BYTES / MIB:g} MiB, {shelf.MOST_REPORT_BYTES / MIB:g} MiB;"
    )
