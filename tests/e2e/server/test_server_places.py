"""Places: who may have how many, who is kept one, and how those who do nothing lose theirs."""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from pdcd.bench.tables import LimitsConfig, ServerConfig
from pdcd.cli.exits import BUSY, exit_code_of
from pdcd.client import Client
from pdcd.errors import BusyError
from pdcd.protocol.line_talk import UnreachableError
from pdcd.server.connections import KEPT_PLACES
from tests.e2e.server._server_harness import (
    PATIENCE_S,
    Daemon,
    Wire,
    daemon,
    served,
    threaded_daemon,
)
from tests.e2e.server._users import ANNA, BERT, CARL, Users
from tests.processes import soon

OPEN = ServerConfig(allow_uids=(ANNA, BERT, CARL))


async def come(stack: AsyncExitStack, running: Daemon, count: int) -> list[Wire]:
    return [await stack.enter_async_context(running.wire()) for _ in range(count)]


def said(wire: Wire) -> str:
    """What the server said first: hello, or the message of its refusal."""
    if "error" not in wire.hello:
        return str(wire.hello["method"])
    assert wire.hello["id"] is None and wire.hello["error"]["data"]["kind"] == "busy"
    return str(wire.hello["error"]["message"])


async def test_who_takes_all_places_locks_out_neither_root_nor_the_daemons_user(
    tmp_path: Path, users: Users
) -> None:
    async with (
        daemon(tmp_path, server=OPEN) as running,
        running.wire() as first,
        AsyncExitStack() as stack,
    ):
        users.become(ANNA)
        hers = await come(stack, running, 9)
        assert [said(wire) for wire in hers[:8]] == ["hello"] * 8
        assert said(hers[8]) == f"8 clients of uid {ANNA} are connected already"
        assert await hers[8].ended()
        users.become(BERT)
        others = await come(stack, running, 8)
        assert [said(wire) for wire in others] == ["hello"] * 8
        users.become(CARL)
        assert said((await come(stack, running, 1))[0]) == "16 clients are connected already"
        users.become()  # `first` has one of the places that are kept
        kept = await come(stack, running, KEPT_PLACES)
        assert [said(wire) for wire in kept[:-1]] == ["hello"] * (KEPT_PLACES - 1)
        assert said(kept[-1]) == "16 clients are connected already"
        for wire in (first, hers[0], others[0]):
            await wire.result("ping")
        # A place that is given back can be had again.
        await hers[0].close()
        users.become(CARL)
        async with asyncio.timeout(PATIENCE_S):
            while said((await come(stack, running, 1))[0]) != "hello":
                await asyncio.sleep(0.01)


async def test_root_is_kept_places_apart_from_the_daemons_user(
    tmp_path: Path, users: Users, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: ANNA)  # as whom the daemon runs

    async with daemon(tmp_path, server=OPEN) as running, AsyncExitStack() as stack:
        users.become(ANNA)
        hers = await come(stack, running, 16 + KEPT_PLACES + 1)
        assert [said(wire) for wire in hers[:-1]] == ["hello"] * (16 + KEPT_PLACES)
        assert said(hers[-1]) == "16 clients are connected already"
        users.become(0)
        assert said((await come(stack, running, 1))[0]) == "hello"


async def test_jobs_of_one_user_that_wait_are_bounded(tmp_path: Path, users: Users) -> None:
    limits = LimitsConfig(queued_per_user=3)

    async with daemon(tmp_path, server=OPEN, limits=limits) as running:
        users.become(ANNA)
        async with running.wire() as wire, running.wire() as again:
            answers = [await begin(w) for w in (wire, again, wire, again, wire, again)]
            assert [kind for kind in answers if kind] == ["busy", "busy"]
            users.become(BERT)
            async with running.wire() as other:
                assert await begin(other) == ""
            users.become()
            async with running.wire() as own:
                assert [await begin(own) for _ in range(5)] == [""] * 5


async def begin(wire: Wire) -> str:
    """Queue a capture; returns the kind of the refusal, if it is refused."""
    answer = await wire.ask("capture.start", goal="white", note="slow", queue=True)
    return str(answer["error"]["data"]["kind"]) if "error" in answer else ""


# --- those who do nothing -----------------------------------------------------------------------

IDLE = LimitsConfig(idle_s=0.6)


async def dismissed(wire: Wire) -> None:
    """The client is told why, and parted from."""
    error = (await wire.answer(None))["error"]
    assert error["data"]["kind"] == "busy" and "0.6 s" in error["message"]
    assert "idle_s" in error["data"]["hint"]
    assert await wire.ended()


@served(limits=IDLE)
async def test_who_wants_nothing_is_parted_from_and_who_wants_something_is_not(
    silent: Wire, noisy: Wire, listener: Wire, shooter: Wire, waiter: Wire, asker: Wire
) -> None:
    await listener.result("events.subscribe", jobs="own")
    job = (await shooter.result("capture.start", goal="white", note="slow"))["job"]
    waiting = asyncio.create_task(waiter.result("capture.wait", job=job))
    noise = asyncio.create_task(drip(noisy))
    begun_s = time.monotonic()
    while time.monotonic() < begun_s + 1.0:
        await asker.result("ping")
        await asyncio.sleep(0.05)
    await dismissed(silent)
    await dismissed(noisy)
    await noise
    assert (await shooter.result("rig.status"))["connections"] == 4
    await listener.result("ping")
    await shooter.result("capture.cancel", job=job)
    assert (await waiting)["state"] == "cancelled"
    # None of them has a reason any more.
    await listener.result("events.unsubscribe")
    for wire in (listener, shooter, waiter, asker):
        await dismissed(wire)


async def drip(wire: Wire) -> None:
    """Send what is no request until the server says something."""
    while not wire.reader._buffer:  # type: ignore[attr-defined]
        await wire.send(b"  ")
        await asyncio.sleep(0.02)


def test_a_client_in_python_learns_why_it_was_parted_from(tmp_path: Path) -> None:
    with threaded_daemon(tmp_path, limits=IDLE) as running, Client(running.path) as client:
        assert soon(lambda: at_end(client))
        with pytest.raises(BusyError, match="asked for nothing"):
            client.status()
        with pytest.raises(UnreachableError):
            client.status()


def at_end(client: Client) -> bool:
    """Whether the daemon has closed the connection, looked at from outside."""
    poll = select.poll()
    poll.register(client._sock, 0)
    return any(event & select.POLLHUP for _, event in poll.poll(0))


# --- a backlog that is full ---------------------------------------------------------------------


@contextlib.contextmanager
def full(path: Path) -> Iterator[socket.socket]:
    """A listener that accepts nobody, with as many before it as it lets wait."""
    with socket.socket(socket.AF_UNIX) as listener, contextlib.ExitStack() as stack:
        listener.bind(str(path))
        listener.listen(1)
        with contextlib.suppress(BlockingIOError):
            while True:
                sock = stack.enter_context(socket.socket(socket.AF_UNIX))
                sock.setblocking(False)
                sock.connect(str(path))
        yield listener


def test_a_full_backlog_is_no_missing_daemon(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with full(path):
        begun_s = time.monotonic()
        with pytest.raises(BusyError, match=r"too many clients wait.*0\.3 s") as caught:
            Client(path, timeout_s=0.3)
        assert 0.3 <= time.monotonic() - begun_s < 5.0
        assert caught.value.hint and exit_code_of(caught.value.kind) == BUSY


def test_a_place_in_the_backlog_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with full(path) as listener:

        def serve() -> None:
            time.sleep(0.2)
            for _ in range(3):  # two who came before, then the client
                with listener.accept()[0] as sock:
                    sock.sendall(b'{"error":{"message":"you were heard","data":{"kind":"sync"}}}\n')

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(Exception, match="you were heard"):
            Client(path, timeout_s=PATIENCE_S)
        thread.join()
