"""Who is let in to the page: the token, the host, tickets, and places of strangers (all at once:
tests/hostile/web_requests.py)."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from aiohttp.test_utils import make_mocked_request
from multidict import CIMultiDict

from pdcd.errors import ConfigError
from pdcd.web import door as module
from pdcd.web.door import BrowserAuth, Refusal, VisitorPlaces
from pdcd.web.serve import bind_loopback

HOST = "127.0.0.1:8137"


def status_of(check: Any, *args: Any) -> int:
    """The status that a check refuses by; 200 where it does not."""
    try:
        check(*args)
    except Refusal as no:
        assert no.why and str(no) == no.why
        return no.status
    return 200


def test_the_token_stands_where_browsers_send_it_to_nobody() -> None:
    door = BrowserAuth("127.0.0.1", 8137)
    origin, _, token = door.address.partition("#")
    assert origin == f"http://{HOST}/" and len(token) == 43
    assert BrowserAuth("127.0.0.1", 8137).address != door.address
    assert BrowserAuth("::1", 8137).address.startswith("http://[::1]:8137/#")


@pytest.mark.parametrize(
    ("shown", "status"),
    [
        (["Bearer {}"], 200), ([], 401), (["Bearer {}"] * 2, 401), (["Bearer {}x"], 401),
        (["bearer {}"], 401), (["{}"], 401), (["Bearer "], 401), (["Bearer \xe9"], 401),
        (["", "Bearer {}"], 401),
    ],
)  # fmt: skip
def test_who_shows_the_token_once_is_let_in(shown: list[str], status: int) -> None:
    door = BrowserAuth("127.0.0.1", 8137)
    token = door.address.partition("#")[2]
    headers = CIMultiDict(("Authorization", each.format(token)) for each in shown)
    request = make_mocked_request("GET", "/runs", headers=headers)
    assert status_of(door.check_token, request) == status


@pytest.mark.parametrize(
    ("hosts", "status"),
    [
        ([HOST], 200), ([], 403), ([HOST, HOST], 403), (["localhost:8137"], 403),
        (["127.0.0.1"], 403), (["evil.example:8137"], 403), ([f"{HOST}.evil.example"], 403),
    ],
)  # fmt: skip
def test_no_name_that_leads_here_is_our_host(hosts: list[str], status: int) -> None:
    headers = CIMultiDict(("Host", host) for host in hosts)
    request = make_mocked_request("GET", "/", headers=headers)
    assert status_of(BrowserAuth("127.0.0.1", 8137).check_host, request) == status


def test_a_ticket_is_for_one_run_of_one_server() -> None:
    door, other = BrowserAuth("127.0.0.1", 8137), BrowserAuth("127.0.0.1", 8137)
    ticket = door.ticket("a")
    assert status_of(door.check_ticket, "a", ticket) == 200
    for job, wrong in (("b", ticket), ("a", other.ticket("a")), ("a", ""), ("a", "\udc80")):
        assert status_of(door.check_ticket, job, wrong) == 404
    assert door.address.partition("#")[2] not in ticket


class Line(asyncio.Transport):
    """A connection that notes whether it was cut."""

    def __init__(self) -> None:
        super().__init__()
        self.cut = asyncio.Event()

    def abort(self) -> None:
        self.cut.set()


def come(places: VisitorPlaces) -> Line:
    line = Line()
    places.enter(line)
    return line


def cut(*lines: Line) -> list[bool]:
    return [line.cut.is_set() for line in lines]


async def test_a_stranger_gives_way_to_the_next_and_a_guest_to_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "STRANGERS", 2)

    places = VisitorPlaces()
    guest, first = come(places), come(places)
    places.admit(guest, None)
    second = come(places)
    assert cut(guest, first, second) == [False, False, False]
    third = come(places)
    assert cut(guest, first, second, third) == [False, True, False, False]
    places.admit(first, 5.0)  # too late
    places.leave(first)
    places.leave(second)
    fourth = come(places)
    assert cut(guest, third, fourth) == [False, False, False]
    places.end()
    assert cut(guest, third, fourth) == [True, True, True]


async def test_the_next_waits_until_the_first_stranger_has_had_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "STRANGERS", 2)
    monkeypatch.setattr(module, "STAY_S", 50.0)
    now_s = asyncio.get_running_loop().time()
    monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: now_s)

    places = VisitorPlaces()
    first = come(places)
    assert places.wait_s() == 0.0
    now_s += 10.0
    come(places)
    assert places.wait_s() == pytest.approx(40.0)
    now_s += 45.0
    assert places.wait_s() == 0.0  # it goes for the next
    now_s -= 45.0
    places.admit(first, None)
    assert places.wait_s() == 0.0
    come(places)
    assert places.wait_s() == pytest.approx(50.0)


async def test_the_token_gives_more_time_and_the_last_word_on_it_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "STRANGER_S", 0.01)

    places = VisitorPlaces()
    gone, slow, known, long = (come(places) for _ in range(4))
    places.leave(gone)
    places.admit(known, 0.02)
    places.admit(long, 0.0)
    places.admit(long, None)
    places.admit(None, 0.0)
    await asyncio.wait_for(slow.cut.wait(), 30.0)
    await asyncio.wait_for(known.cut.wait(), 30.0)
    assert cut(gone, long) == [False, False]


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "192.168.0.1", "localhost", "", "::ffff:127.0.0.1", "::ffff:0.0.0.0"]
)
def test_no_other_interface_is_served(host: str) -> None:
    with pytest.raises(ConfigError):
        bind_loopback(host, 0)
