"""What pages are told: from where they come in, and not more than they read."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import BusyError
from pdcd.protocol import events
from pdcd.web import news as module
from pdcd.web.asks import DaemonQueries
from pdcd.web.news import News, TooManyPagesError


class NoAnswers(DaemonQueries):
    """A daemon that is always idle."""

    def __init__(self) -> None:
        super().__init__(Path("/nowhere"))
        self.asked = 0

    async def ask(self, method: str, params: object = None, **unused: object) -> Any:
        self.asked += 1
        await asyncio.sleep(0)
        return {"state": "idle"}


async def read(page: AsyncGenerator[bytes, None]) -> dict[str, Any]:
    data = await asyncio.wait_for(anext(page), 5.0)
    told: dict[str, Any] = json.loads(data.removeprefix(b"data: "))
    return told


def progress(frame: int, job: str = "one") -> events.Event:
    return events.Progress(job=job, shot="coded", frame=frame, frames=900, missed=0)


def test_a_page_that_comes_late_is_told_what_matters() -> None:
    async def scenario() -> None:
        asks = NoAnswers()
        told = News(Path("/nowhere"), asks)
        told._arrived()
        told._heard(events.JobQueued(job="one", ahead=0))
        told._heard(events.JobStarted(job="one", goal="white"))
        for frame in range(500):
            told._heard(progress(frame))
        await asyncio.sleep(0.01)
        assert 1 <= asks.asked <= 3
        page = told.page()
        first = await read(page)
        assert first["here"] and first["status"] == {"state": "idle"}
        assert [(await read(page))["type"] for _ in range(2)] == ["queued", "started"]
        last = await read(page)
        assert (last["frame"], last["words"]) == (499, "coded: 499/900 refreshes")
        assert last["share"] == 499 / 900
        # Of a job that has ended nothing is told once another one begins.
        told._heard(events.JobDone(job="one"))
        told._heard(events.JobQueued(job="two", ahead=0))
        late = told.page()
        await read(late)
        assert (await read(late))["job"] == "two"
        await page.aclose()
        await late.aclose()
        await told.close()

    asyncio.run(scenario())


def test_a_page_that_does_not_read_is_given_up_and_thinned_news_first() -> None:
    async def scenario() -> None:
        told = News(Path("/nowhere"), NoAnswers())
        page = told.page()
        assert not (await read(page))["here"]
        for frame in range(2 * module.UNREAD):
            told._heard(progress(frame))
        assert [queue.qsize() for queue in told._pages] == [module.UNREAD // 2]
        held = [await read(page) for _ in range(module.UNREAD // 2)]
        assert [each["frame"] for each in held] == list(range(module.UNREAD // 2))
        for _ in range(module.UNREAD + 1):
            told._heard(events.ShotArmed(job="one", shot="coded", frames=9))
        with pytest.raises(StopAsyncIteration):
            await anext(page)
        await told.close()

    asyncio.run(scenario())


def test_no_more_pages_than_there_are_places() -> None:
    async def scenario() -> None:
        told = News(Path("/nowhere"), NoAnswers())
        pages = [told.page() for _ in range(module.PAGES)]
        for page in pages:
            await read(page)
        with pytest.raises(TooManyPagesError):
            await anext(told.page())
        await pages[0].aclose()
        again = told.page()
        await read(again)
        for page in (*pages, again):
            await page.aclose()
        await told.close()

    asyncio.run(scenario())


def test_a_daemon_that_stays_away_is_told_of_once() -> None:
    async def scenario() -> None:
        told = News(Path("/nowhere"), NoAnswers())
        page = told.page()
        await read(page)
        told._arrived()
        assert (await read(page))["here"]
        for _ in range(3):
            told._gone("no daemon answers")
        gone = await read(page)
        assert (gone["here"], gone["why"], gone["status"]) == (False, "no daemon answers", None)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(anext(page), 0.05)
        await told.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("error", [BusyError("too much"), ConnectionResetError("gone")])
def test_a_state_that_cannot_be_asked_for_is_none(error: Exception) -> None:
    class Silent(NoAnswers):
        async def ask(self, method: str, params: object = None, **unused: object) -> Any:
            raise error

    async def scenario() -> None:
        told = News(Path("/nowhere"), Silent())
        told._arrived()
        assert told._refresh is not None
        await told._refresh  # which raises nothing
        page = told.page()
        first = await read(page)
        assert (first["here"], first["status"], first["visit"]) == (True, None, 1)
        await page.aclose()
        await told.close()

    asyncio.run(scenario())


def test_pages_are_told_of_every_arrival_anew() -> None:
    async def scenario() -> None:
        told = News(Path("/nowhere"), NoAnswers())
        for visit in (1, 2):
            told._heard(events.JobQueued(job=str(visit), ahead=0))
            told._arrived()
            assert told._visit == visit and not told._events
            await asyncio.sleep(0.01)
            told._gone("away")
        assert told._state()["why"] == "away"
        told._gone("still away")  # another reason is news
        assert told._state()["why"] == "still away"
        await told.close()

    asyncio.run(scenario())
