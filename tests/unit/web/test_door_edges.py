"""The rules of the door where they are close: what comes twice, and what is just allowed."""

from __future__ import annotations

import re
from typing import Any

import pytest

from pdcd.web.door import ENTER, REPORT, Asked, Door, Refused
from tests.unit.web.test_door import HOST, asked, opened


def refused(door: Door, request: Asked) -> int:
    with pytest.raises(Refused) as no:
        door.look(request)
    assert no.value.why and str(no.value) == no.value.why
    return no.value.status


@pytest.mark.parametrize("name", ["host", "origin", "sec-fetch-site", "content-length"])
def test_a_header_that_decides_may_come_once(name: str) -> None:
    door, _ = opened()
    values = {"host": HOST, "origin": f"http://{HOST}", "sec-fetch-site": "none"}
    once = {"host": HOST, name: values.get(name, "0")}
    door.look(Asked.of("GET", f"{door.room}/", once.items()))
    twice = [*once.items(), (name.upper(), once[name])]
    assert refused(door, Asked.of("GET", f"{door.room}/", twice)) == 400


def test_a_cookie_that_comes_twice_is_told_from_a_wrong_one() -> None:
    door, cookie = opened()
    path = f"{door.room}/"
    statuses = []
    for given in ([cookie, cookie], ["a@b=1; " + cookie], ["pdcd-8137=x"], []):
        with pytest.raises(Refused) as no:
            door.check(Asked.of("GET", path, [("Cookie", value) for value in given]))
        statuses.append(no.value.status)
    # The second is one that the library cannot read.
    assert statuses == [400, 401, 401, 401]
    door.check(Asked.of("GET", path, [("Cookie", cookie)]))


def test_values_of_headers_are_found_by_name_in_any_letters_and_in_order() -> None:
    request = Asked.of("GET", "/", [("X-One", "A"), ("x-ONE", "B"), ("X-Two", "C")])
    assert (request.all("x-one"), request.all("x-none")) == (["A", "B"], [])
    assert (request.one("x-two"), request.one("x-none")) == ("C", None)


@pytest.mark.parametrize(
    "headers",
    [
        {"content_length": "0"},
        {"sec_fetch_site": "none"},
        {"sec_fetch_site": None},
        {"sec_purpose": "print"},
        {"origin": f"http://{HOST}"},
    ],
)
def test_what_a_browser_may_say_is_let_pass(headers: dict[str, Any]) -> None:
    door, _ = opened()
    door.look(asked(f"{door.room}/", **headers))


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"purpose": "prefetch"}, 403),
        ({"sec_purpose": "prefetch;prerender", "purpose": "x"}, 403),
        ({"transfer_encoding": "chunked"}, 400),
        ({"content_length": "0", "transfer_encoding": "chunked"}, 400),
        ({"content_length": ""}, 400),
    ],
)
def test_what_a_visit_does_not_need_is_refused(headers: dict[str, Any], status: int) -> None:
    door, _ = opened()
    assert refused(door, asked(f"{door.room}/", **headers)) == status


def test_the_length_of_a_body_is_a_plain_number_of_up_to_nine_digits() -> None:
    door, _ = opened()
    for good in ("0", "2", "999999999"):
        door.look(asked(f"{door.room}/plan", method="POST", content_length=good))
    for wrong in ("", "1000000000", "-1", "+1", " 1", "1.0", "0x1", "\u0661"):
        request = asked(f"{door.room}/plan", method="POST", content_length=wrong)
        assert refused(door, request) == 411


def test_an_address_may_have_256_letters() -> None:
    door, _ = opened()
    door.look(asked("/" + "a" * 255))
    assert refused(door, asked("/" + "a" * 256)) == 404


def test_the_token_is_not_spent_by_a_wish() -> None:
    door = Door("127.0.0.1", 8137)
    path = door.address.removeprefix(door.origin)
    for wrong in (asked(path, method="POST"), asked(f"{path}x"), asked(ENTER)):
        with pytest.raises(Refused) as no:
            door.exchange(wrong)
        assert no.value.status == 403
    assert door.exchange(asked(path)).startswith("pdcd-8137=")
    assert door.address == f"{door.origin}{ENTER}"


def test_what_cannot_be_guessed_has_its_length() -> None:
    door = Door("127.0.0.1", 8137)
    # Of 12 and 24 random bytes; six bits a letter.
    assert re.fullmatch(r"/[\w-]{16}", door.room)
    assert re.fullmatch(rf"{REPORT}[\w-]{{32}}", door.ticket("j"))
    assert door.room != Door("127.0.0.1", 8137).room and door.ticket("j") != door.ticket("j")


def test_the_last_64_tickets_are_good() -> None:
    door = Door("127.0.0.1", 8137)
    tickets = [door.ticket(str(number)) for number in range(65)]
    found = [door.job_of(asked(ticket)) for ticket in tickets[1:]]
    assert found == [str(number) for number in range(1, 65)]
    for wrong in (tickets[0], tickets[1] + "x", REPORT):
        with pytest.raises(Refused) as no:
            door.job_of(asked(wrong))
        assert no.value.status == 404
