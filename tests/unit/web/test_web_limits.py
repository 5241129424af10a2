"""Limits of the page: those that the document tells, what the library is told, and their order."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web

from pdcd.web import app, asks, guard, news, serve, shelf, turns
from pdcd.web.serve import bound, serving
from tests.places import ROOT

KIB, MIB = 2**10, 2**20


def documented() -> dict[str, str]:
    """The table of limits, by what is limited."""
    text = (ROOT / "docs" / "web.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return {row[0]: row[1] for row in rows if len(row) == 2}


def test_the_limits_are_those_of_the_document() -> None:
    told = documented()
    assert told["connections"].startswith(f"{guard.MOST}, and {guard.STRANGERS} that have not")
    assert told["time of a request"] == (
        f"{guard.STRANGER_S:g} s until it has shown the cookie, {guard.REQUEST_S:g} s in all; "
        f"{app.LONG_S:g} s where the rig is asked"
    )
    assert told["head of a request"] == (
        f"{serve.MOST_HEADERS} lines of up to {serve.MOST_HEADER_BYTES / KIB:g} KiB, "
        f"the first {serve.MOST_LINE_BYTES / KIB:g} KiB"
    )
    assert told["body of a request"] == (
        f"1 MiB less {(MIB - app.MOST_BYTES) / KIB:g} KiB for a photo, "
        f"{app.SMALL_BYTES / KIB:g} KiB else"
    )
    assert told["pages that are told news"] == str(news.PAGES)
    assert told["questions to the daemon"].startswith(f"{asks.AT_A_TIME} at a time, and one more")
    assert told["pictures, reports"].startswith(
        f"{shelf.MOST_PICTURE_BYTES / MIB:g} MiB, {shelf.MOST_REPORT_BYTES / MIB:g} MiB;"
    )


def test_who_waits_is_told_before_another_limit_cuts_the_wait() -> None:
    # A page that does not read is noticed before the next sign of life is due, and a sign of life
    # comes before anybody could take the silence for an end.
    assert app.WRITE_S < news.BEAT_S < guard.REQUEST_S
    # Without a turn, or a greeting, one hears so before an answer would be overdue.
    assert turns.WAIT_S < asks.ANSWER_S and asks.CONNECT_S < asks.ANSWER_S
    assert turns.WAIT_S + asks.ANSWER_S < guard.REQUEST_S
    assert serve.BACKLOG == guard.MOST


def test_the_library_is_kept_from_all_that_was_not_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: dict[str, Any] = {}

    class Runner(web.AppRunner):
        def __init__(self, site: web.Application, **how: Any) -> None:
            told.update(how)
            super().__init__(site, **how)

    async def scenario() -> None:
        async with serving(bound("127.0.0.1", 0), tmp_path / "none", tmp_path):
            pass

    monkeypatch.setattr(web, "AppRunner", Runner)
    asyncio.run(scenario())
    logger = told.pop("logger")
    assert logger.disabled and logger.name.startswith("pdcd.")
    assert told == {
        "handle_signals": False,  # they end the page in good order, which is ours to do
        "handler_cancellation": True,  # who leaves is not worked for
        "access_log": None,
        "lingering_time": 0.0,
        "auto_decompress": False,  # no body grows
        "max_line_size": KIB,
        "max_field_size": 4 * KIB,
        "max_headers": 64,
    }
