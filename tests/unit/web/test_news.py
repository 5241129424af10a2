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
from pdcd.web.news import BEAT, News, TooManyPagesError


async def read(page: AsyncGenerator[bytes, None]) -> dict[str, Any]:
    data = await asyncio.wait_for(anext(page), 5.0)
    told: dict[str, Any] = json.loads(data.removeprefix(b"data: "))
    return told


def progress(frame: int, job: str = "one") -> events.Event:
    return events.Progress(job=job, shot="coded", frame=frame, frames=900, missed=0)


async def test_a_page_that_comes_late_is_told_what_matters() -> None:

    asks = Slow()
    told = News(Path("/nowhere"), asks)
    told._arrived()
    told._heard(events.JobQueued(job="one", ahead=0))
    told._heard(events.JobStarted(job="one", goal="white"))
    for frame in range(500):
        told._heard(progress(frame))
    await turns()
    assert 1 <= asks.asked <= 3
    page = told.page()
    first = await read(page)
    assert first["here"] and first["status"] == {"state": f"asked {asks.asked}"}
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


async def test_a_page_that_does_not_read_is_given_up_and_thinned_news_first() -> None:

    told = News(Path("/nowhere"), Slow())
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


async def test_no_more_pages_than_there_are_places() -> None:

    told = News(Path("/nowhere"), Slow())
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


async def test_a_daemon_that_stays_away_is_told_of_once() -> None:

    told = News(Path("/nowhere"), Slow())
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


@pytest.mark.parametrize("error", [BusyError("too much"), ConnectionResetError("gone")])
async def test_a_state_that_cannot_be_asked_for_is_none(error: Exception) -> None:
    class Silent(Slow):
        async def ask(self, method: str, params: object = None, **unused: object) -> Any:
            raise error

    told = News(Path("/nowhere"), Silent())
    told._arrived()
    assert told._refresh is not None
    await told._refresh  # which raises nothing
    page = told.page()
    first = await read(page)
    assert (first["here"], first["status"], first["visit"]) == (True, None, 1)
    await page.aclose()
    await told.close()


class Slow(DaemonQueries):
    """A daemon that answers when it is let; `asked` is how often it was asked."""

    def __init__(self, *, answers: bool = True) -> None:
        super().__init__(Path("/nowhere"))
        self.asked = 0
        self.free = asyncio.Event()
        if answers:
            self.free.set()

    async def ask(self, method: str, params: object = None, **unused: object) -> Any:
        assert method == "rig.status"
        self.asked += 1
        await self.free.wait()
        return {"state": f"asked {self.asked}"}


async def turns(count: int = 10) -> None:
    """Let all that can go on go on."""
    for _ in range(count):
        await asyncio.sleep(0)


def waiting(told: News) -> list[Any]:
    """What waits for the only page."""
    (queue,) = told._pages
    found = []
    while not queue.empty():
        data = queue.get_nowait()
        found.append(None if data is None else json.loads(data.removeprefix(b"data: ")))
    return found


def armed(number: int, job: str = "one") -> events.Event:
    return events.ShotArmed(job=job, shot=f"s{number}", frames=9)


async def test_a_page_to_which_nothing_is_told_gets_signs_of_life(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "BEAT_S", 0.0)

    told = News(Path("/nowhere"), Slow())
    page = told.page()
    assert json.loads((await anext(page)).removeprefix(b"data: "))["what"] == "state"
    assert [await anext(page) for _ in range(3)] == [BEAT] * 3
    assert BEAT.startswith(b":") and BEAT.endswith(b"\n\n")  # a comment, and its end
    await page.aclose()
    await told.close()


@pytest.mark.parametrize(
    ("event", "asks"),
    [
        (events.JobQueued(job="one", ahead=0), 1),
        (events.JobStarted(job="one", goal="white"), 1),
        (events.JobDone(job="one"), 1),
        (events.ShotArmed(job="one", shot="s", frames=9), 0),
        (events.Progress(job="one", shot="s", frame=1, frames=9, missed=0), 0),
    ],
)
async def test_the_state_is_asked_for_when_a_job_comes_begins_or_ends(
    event: events.Event, asks: int
) -> None:

    daemon = Slow()
    told = News(Path("/nowhere"), daemon)
    told._heard(event)
    await turns()
    assert daemon.asked == asks
    await told.close()


async def test_the_state_is_asked_for_once_more_where_it_may_have_changed_meanwhile() -> None:

    daemon = Slow(answers=False)
    told = News(Path("/nowhere"), daemon)
    page = told.page()
    await anext(page)
    told._arrived()
    await turns()
    for _ in range(3):
        told._heard(events.JobQueued(job="one", ahead=0))
    assert daemon.asked == 1
    daemon.free.set()
    await turns()
    assert daemon.asked == 2
    states = [m["status"]["state"] for m in waiting(told) if m["what"] == "state"]
    assert states == ["asked 1", "asked 2"]
    await turns()
    assert daemon.asked == 2
    await page.aclose()
    await told.close()


async def test_a_state_of_a_daemon_that_has_gone_meanwhile_is_not_told() -> None:

    daemon = Slow(answers=False)
    told = News(Path("/nowhere"), daemon)
    page = told.page()
    await anext(page)
    told._arrived()
    await turns()
    told._gone("unplugged")
    daemon.free.set()
    await turns()
    (gone,) = waiting(told)
    assert (gone["here"], gone["why"], gone["status"]) == (False, "unplugged", None)
    assert told._state()["status"] is None
    await page.aclose()
    await told.close()


async def test_what_is_told_of_a_job_that_still_runs_is_kept_when_another_one_comes() -> None:

    told = News(Path("/nowhere"), Slow())
    ends = (
        events.JobDone(job="two"),
        events.JobFailed(job="three", error={"kind": "sync", "message": "late"}),
        events.JobCancelled(job="four"),
    )
    for event in (armed(1), armed(2, "two"), armed(3, "three"), armed(4, "four"), *ends):
        told._heard(event)
    told._heard(events.Progress(job="one", shot="s", frame=1, frames=9, missed=0))
    told._heard(armed(5, "five"))  # no job begins
    assert len(told._events) == 9
    told._heard(events.JobQueued(job="six", ahead=1))
    assert [(m["job"], m["type"]) for _, m in told._events] == [
        ("one", "armed"), ("one", "progress"), ("five", "armed"), ("six", "queued"),
    ]  # fmt: skip
    told._heard(events.JobQueued(job="six", ahead=0))  # the same one again: nothing is forgotten
    assert len(told._events) == 5
    await told.close()


async def test_the_end_comes_though_the_daemon_does_not_answer() -> None:

    told = News(Path("/nowhere"), Slow(answers=False))
    page = told.page()
    await anext(page)
    told._arrived()
    await turns()
    await told.close()
    assert told._refresh is not None and told._refresh.cancelled()
    assert told._ended.is_set()
    with pytest.raises(StopAsyncIteration):
        await anext(page)
