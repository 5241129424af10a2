"""Who is let in to the page: the rules one by one (all at once: tests/hostile/web_requests.py)."""

from __future__ import annotations

import re

import pytest

from pdcd.errors import ConfigError
from pdcd.web.door import ENTER, Asked, Door, Refused
from pdcd.web.serve import bound

HOST = "127.0.0.1:8137"


def asked(path: str, *, method: str = "GET", **headers: str | None) -> Asked:
    """A request of the page itself, but for what is given; None leaves a header out."""
    all_headers: dict[str, str | None] = {"host": HOST, "sec_fetch_site": "same-origin"}
    if method == "POST":
        all_headers |= {
            "origin": f"http://{HOST}", "content_type": "application/json", "content_length": "2",
        }  # fmt: skip
    all_headers |= headers
    given = [(k.replace("_", "-").title(), v) for k, v in all_headers.items() if v is not None]
    return Asked.of(method, path, given)


def opened() -> tuple[Door, str]:
    """A door whose token was exchanged, and the cookie."""
    door = Door("127.0.0.1", 8137)
    header = door.exchange(asked(door.address.removeprefix(door.origin), sec_fetch_site="none"))
    return door, header.partition(";")[0]


def test_the_cookie_is_for_one_path_no_script_and_no_other_site() -> None:
    door = Door("127.0.0.1", 8137)
    assert re.fullmatch(rf"http://{HOST}{ENTER}[\w-]{{43}}", door.address)
    header = door.exchange(asked(door.address.removeprefix(door.origin)))
    name, *flags = header.split("; ")
    assert re.fullmatch(r"pdcd-8137=[\w-]{43}", name)
    assert set(flags) == {f"Path={door.room}/", "HttpOnly", "SameSite=Strict"}
    door.check(asked(f"{door.room}/runs", cookie=f"other=1; {name}"))
    with pytest.raises(Refused) as no:
        door.check(asked("/runs", cookie=name))
    assert no.value.status == 401


def test_the_token_is_void_after_its_first_use() -> None:
    door, _ = opened()
    for path in (ENTER, f"{ENTER}x", door.address.removeprefix(door.origin)):
        with pytest.raises(Refused) as no:
            door.exchange(asked(path))
        assert no.value.status == 403


def test_nobody_is_let_in_before_the_exchange() -> None:
    door = Door("127.0.0.1", 8137)
    for cookie in ("", "pdcd-8137=", "pdcd-8137=None", None):
        with pytest.raises(Refused):
            door.check(asked(f"{door.room}/", cookie=cookie))


@pytest.mark.parametrize(
    ("method", "wrong", "status"),
    [
        ("GET", {"host": "localhost:8137"}, 403),
        ("GET", {"host": None}, 403),
        ("GET", {"origin": "http://127.0.0.1:8138"}, 403),
        ("GET", {"sec_fetch_site": "same-site"}, 403),
        ("GET", {"sec_purpose": "prefetch"}, 403),
        ("GET", {"content_length": "1"}, 400),
        ("GET", {"upgrade": "websocket"}, 400),
        ("HEAD", {}, 405),
        ("POST", {"origin": None}, 403),
        ("POST", {"origin": "null"}, 403),
        ("POST", {"content_type": "text/plain"}, 415),
        ("POST", {"content_length": None}, 411),
        ("POST", {"transfer_encoding": "chunked"}, 411),
        ("POST", {"content_encoding": "gzip"}, 411),
    ],
)
def test_what_is_not_of_the_page_is_refused(
    method: str, wrong: dict[str, str | None], status: int
) -> None:
    door, _ = opened()
    door.look(asked(f"{door.room}/runs", method="POST" if method == "POST" else "GET"))
    with pytest.raises(Refused) as no:
        door.look(asked(f"{door.room}/runs", method=method, **wrong))
    assert no.value.status == status


@pytest.mark.parametrize(
    "path", ["/a?b", "/a/../b", "//a", "/%61", "/a\\b", "*", "http://x/", "/.a"]
)
def test_addresses_have_nothing_to_be_decoded(path: str) -> None:
    with pytest.raises(Refused) as no:
        Door("127.0.0.1", 8137).look(asked(path))
    assert no.value.status == 404


def test_an_address_of_the_newer_internet_has_brackets() -> None:
    assert Door("::1", 8137).origin == "http://[::1]:8137"


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "192.168.0.1", "localhost", "", "::ffff:127.0.0.1", "::ffff:0.0.0.0"]
)
def test_no_other_interface_is_served(host: str) -> None:
    with pytest.raises(ConfigError):
        bound(host, 0)


def test_a_port_that_is_taken_or_none_is_said() -> None:
    with bound("127.0.0.1", 0) as sock:
        assert sock.getsockname()[0] == "127.0.0.1"
        for port in (sock.getsockname()[1], 70_000, -1):
            with pytest.raises(ConfigError, match="cannot listen"):
                bound("127.0.0.1", port)


def test_bytes_that_are_no_text_open_nothing() -> None:
    """They come as halves of characters, which no encoding has."""
    door, cookie = opened()
    with pytest.raises(Refused) as no:
        Door("127.0.0.1", 8137).exchange(asked(f"{ENTER}\udc80"))
    assert no.value.status == 403
    for wrong in (f"{cookie[:-1]}\udc80", f"{cookie}x", cookie[:-1]):
        with pytest.raises(Refused) as no:
            door.check(asked(f"{door.room}/", cookie=wrong))
        assert no.value.status == 401
    door.check(asked(f"{door.room}/", cookie=cookie))
