"""Names and groups of those who connect, where the system does not tell them."""

from __future__ import annotations

import asyncio
import pwd
import socket
import struct
import threading
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pdcd.bench.tables import RoleConfig, ServerConfig
from pdcd.errors import ConfigError
from pdcd.server import access
from pdcd.server.access import Access, Names, Peer, peer_of
from tests.processes import LONG_S


def test_who_connected_is_known_where_the_kernel_tells_no_groups(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def getsockopt(level: int, option: int, size: int) -> bytes:
        if option == socket.SO_PEERCRED:
            return struct.pack("3i", 41, 42, 43)
        raise OSError("no such option")

    kernel = cast(Any, SimpleNamespace(getsockopt=getsockopt))
    assert peer_of(kernel) == Peer(41, 42, 43, "42", frozenset())
    assert "groups of a client are not known" in caplog.text


@pytest.mark.parametrize("error", [KeyError(70001), OSError("the server is away")])
def test_a_user_without_a_name_is_a_number(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(uid: int) -> None:
        raise error

    async def scenario() -> str:
        return await Names().of(70001)

    monkeypatch.setattr(pwd, "getpwuid", fails)
    assert asyncio.run(scenario()) == "70001"


def test_a_user_is_called_by_name() -> None:
    async def scenario() -> str:
        return await Names().of(0)

    assert asyncio.run(scenario()) == pwd.getpwuid(0).pw_name


def test_a_name_is_believed_for_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, asked = 1000.0, []

    def look_up(uid: int) -> str:
        asked.append(uid)
        return f"user {len(asked)}"

    async def scenario() -> None:
        nonlocal now_s
        names = Names(look_up)
        monkeypatch.setattr(access, "time", SimpleNamespace(monotonic=lambda: now_s))
        assert await names.of(7) == "user 1"
        now_s += 59.9
        assert await names.of(7) == "user 1" and asked == [7]
        now_s += 0.1
        assert await names.of(7) == "user 2"
        assert await names.of(8) == "user 3" and asked == [7, 7, 8]

    asyncio.run(scenario())


def test_a_look_up_that_fails_is_made_again_and_the_end_waits_for_none() -> None:
    free, asked = threading.Event(), []

    def look_up(uid: int) -> str:
        asked.append(uid)
        if len(asked) == 1:
            raise ZeroDivisionError
        assert free.wait(LONG_S)
        return "anna"

    async def scenario() -> None:
        names = Names(look_up)
        with pytest.raises(ZeroDivisionError):
            await names.of(7)
        waits = asyncio.create_task(names.of(7))
        async with asyncio.timeout(LONG_S):
            while len(asked) < 2:
                await asyncio.sleep(0.001)
            await names.close()
        with pytest.raises(asyncio.CancelledError):
            await waits
        assert not names._asked

    try:
        asyncio.run(scenario())
    finally:
        free.set()


def test_a_group_without_a_number_is_named_with_a_way_out() -> None:
    tables = ServerConfig(shoot=RoleConfig(groups=("no such group",)))
    with socket.socket(socket.AF_UNIX) as sock, pytest.raises(ConfigError) as caught:
        Access.to(sock, tables)
    assert caught.value.message == "there is no group 'no such group'"
    assert "[server]" in str(caught.value.hint)
