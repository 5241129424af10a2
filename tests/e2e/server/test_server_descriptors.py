"""Descriptors that come with requests arrive, and none stays open, whatever a client does."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import resource
import socket
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pdcd.client import Client
from pdcd.errors import ProtocolError
from pdcd.protocol.messages import MAX_FDS
from pdcd.server import connections
from tests.e2e.server._house import Guest, held, house
from tests.e2e.server._server_harness import PATIENCE_S

PLAN = {"jsonrpc": "2.0", "id": 1, "method": "capture.plan", "params": {"goal": "white"}}


@pytest.fixture
def files() -> Iterator[list[int]]:
    """Descriptors of as many files as may be sent at a time and one more, of known contents."""
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(tempfile.TemporaryFile()) for _ in range(MAX_FDS + 1)]
        for k, file in enumerate(made):
            os.pwrite(file.fileno(), b"file %d" % k, 0)
        yield [file.fileno() for file in made]


def attacked(folder: Path, body: Callable[[Guest], object]) -> None:
    """Let a guest do this to a server, see that nothing is left and that others are served."""

    async def scenario() -> None:
        async with house(folder) as home:
            await home.visit(body)
            await home.visit(lambda guest: guest.send(PLAN))

    asyncio.run(scenario())


def plan(count: int, note: str = "", **envelope: Any) -> dict[str, Any]:
    params = {"goal": "white", "note": note}
    return {**PLAN, "fds": count, "params": params, **envelope}


# --- what is meant ------------------------------------------------------------------------------


def test_descriptors_arrive_with_their_requests_in_order(tmp_path: Path, files: list[int]) -> None:
    def body(guest: Guest) -> None:
        guest.send(plan(2, id=1), files[:2])
        assert guest.read()["result"]["texts"] == ["file 0", "file 1"]
        # Two requests in one message, and one that takes none between them.
        lines = [plan(1, id=2), PLAN, plan(3, id=3)]
        guest.send(b"".join(json.dumps(line).encode() + b"\n" for line in lines), files[3:7])
        told = {answer["id"]: answer["result"]["texts"] for answer in (guest.read() for _ in lines)}
        assert told == {2: ["file 3"], 1: [], 3: ["file 4", "file 5", "file 6"]}
        # A request of many pieces, whose descriptors come with the first.
        long = json.dumps(plan(16, note="x" * 4000)).encode() + b"\n"
        guest.send(long[:10], files[:16])
        for k in range(10, len(long), 1000):
            guest.send(long[k : k + 1000])
        assert guest.read()["result"]["texts"] == [f"file {k}" for k in range(16)]

    attacked(tmp_path, body)


async def test_the_client_passes_descriptors_and_keeps_its_own(
    tmp_path: Path, files: list[int]
) -> None:
    async with house(tmp_path) as home:

        def use() -> None:
            with Client(home.path) as client:
                params = {"goal": "white", "out": "x" * 1_000_000}
                for _ in range(3):
                    asked = client._send("capture.plan", params, files[:16])
                    told = client._answer(asked, PATIENCE_S, None)
                    assert told["texts"] == [f"file {k}" for k in range(16)]
                with pytest.raises(ProtocolError, match="17 descriptors"):
                    client._send("capture.plan", None, files)
            assert os.pread(files[0], 10, 0) == b"file 0"

        await asyncio.to_thread(use)
        await home.tidy()


# --- what is not --------------------------------------------------------------------------------


def test_more_than_a_message_may_carry(tmp_path: Path, files: list[int]) -> None:
    def body(guest: Guest) -> None:
        guest.send(plan(16), files)
        assert (guest.kind(), guest.kind()) == ("protocol", "")

    attacked(tmp_path, body)


def test_more_than_may_wait_for_their_request(tmp_path: Path, files: list[int]) -> None:
    def body(guest: Guest) -> None:
        with contextlib.suppress(OSError):
            for fd in files:
                guest.send(b" ", [fd])
        assert (guest.kind(), guest.kind()) == ("protocol", "")

    attacked(tmp_path, body)


@pytest.mark.parametrize(
    "line",
    [
        b"nonsense\n",
        b"[]\n",
        json.dumps(plan(17)).encode() + b"\n",
        json.dumps(plan(-1)).encode() + b"\n",
        json.dumps({**PLAN, "fds": True}).encode() + b"\n",
        json.dumps({**PLAN, "fds": [1]}).encode() + b"\n",
        json.dumps(plan(3)).encode() + b"\n",
        json.dumps(plan(3, jsonrpc="1.0")).encode() + b"\n",
        b"x" * 2**20 + b"\n",
    ],
)
def test_a_client_whose_count_is_in_doubt_is_parted_from(
    tmp_path: Path, files: list[int], line: bytes
) -> None:
    def body(guest: Guest) -> None:
        with contextlib.suppress(OSError):
            guest.send(line, files[:2])
            guest.send(plan(2), files[2:4])
        assert (guest.kind(), guest.kind()) == ("protocol", "")

    attacked(tmp_path, body)


@pytest.mark.parametrize(
    "message",
    [
        {"jsonrpc": "2.0", "id": 1, "method": "ping", "fds": 2},
        {"jsonrpc": "2.0", "id": 1, "method": "nonsense", "fds": 2},
        plan(2, params={"goal": "sideways"}),
        plan(2, note="refuse"),
        plan(2, note="break"),
    ],
)
def test_a_request_in_vain_costs_its_own_descriptors_only(
    tmp_path: Path, files: list[int], message: dict[str, Any]
) -> None:
    def body(guest: Guest) -> None:
        for _ in range(20):
            guest.send(message, files[:2])
            assert guest.kind()
            guest.send({**message, "id": None}, [])  # no id is a fault, without descriptors
            assert guest.kind() == "protocol"
        guest.send(plan(1), files[5:6])
        assert guest.read()["result"]["texts"] == ["file 5"]

    attacked(tmp_path, body)


def test_a_notification_and_an_end_of_stream_leave_none(tmp_path: Path, files: list[int]) -> None:
    def body(guest: Guest) -> None:
        message = plan(2)
        del message["id"]
        for _ in range(20):
            guest.send(message, files[:2])
        guest.send(b"{", files[:16])  # never completed, never named

    attacked(tmp_path, body)


async def test_one_who_may_not_come_in_leaves_none(tmp_path: Path, files: list[int]) -> None:
    async with house(tmp_path, frozenset({os.getuid() + 1})) as home:

        def push() -> None:
            guest = Guest(home.path)
            with contextlib.suppress(OSError):
                for _ in range(10):
                    guest.send(plan(16), files[:16])
            assert guest.kind() == "denied"
            guest.close()

        await asyncio.to_thread(push)
        await home.tidy()


async def test_open_requests_hold_a_bounded_number(tmp_path: Path, files: list[int]) -> None:
    async with house(tmp_path) as home:
        loop = asyncio.get_running_loop()

        def body(guest: Guest) -> None:
            guest.send(plan(10, note="wait", id="first"), files[:10])
            for _ in range(10):
                guest.send(plan(10, note="wait", id="more"), files[:10])
                assert guest.kind() == "busy"
                most = home.before + len(("guest", "accepted")) + 10 + 10
                assert held() <= most
            loop.call_soon_threadsafe(home.service.gate.set)
            assert guest.read()["id"] == "first"
            guest.send(plan(16, id="later"), files[:16])
            assert "result" in guest.read()

        await home.visit(body)


async def test_a_request_given_up_at_the_end_of_the_daemon_leaves_none(
    tmp_path: Path, files: list[int]
) -> None:
    async with house(tmp_path) as home:
        guest = await asyncio.to_thread(Guest, home.path)
        await asyncio.to_thread(guest.send, plan(10, note="wait"), files[:10])
        async with asyncio.timeout(PATIENCE_S):
            while held() < home.before + 12:
                await asyncio.sleep(0.002)
        await asyncio.to_thread(guest.read)
    guest.close()


@contextlib.contextmanager
def lingering() -> Iterator[int]:
    """A descriptor whose closing takes 2 s: a connection that shall first deliver what nobody
    reads."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        sender = socket.create_connection(listener.getsockname())
        receiver, _ = listener.accept()
    with receiver:
        sender.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                sender.send(b"x" * 65536)
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 2))
        yield sender.detach()


async def test_what_takes_long_to_close_holds_up_nobody(tmp_path: Path) -> None:
    async with house(tmp_path) as home:
        with lingering() as slow:
            guest = await asyncio.to_thread(Guest, home.path)
            await asyncio.to_thread(guest.read)
            await asyncio.to_thread(guest.send, plan(1, note="wait"), [slow])
            os.close(slow)  # the last copy is the server's
            home.service.gate.set()
            begun_s = time.monotonic()
            await home.visit_only(lambda guest: guest.send(PLAN))
            assert time.monotonic() - begun_s < 1.0
            assert (await asyncio.to_thread(guest.read))["id"] == 1
            guest.close()
            await home.tidy(less=1)  # the receiver
            assert time.monotonic() - begun_s > 1.5, "closing was no matter of time"


async def test_running_out_of_descriptors_ends_nothing_but_the_attack(
    tmp_path: Path, files: list[int]
) -> None:
    async with house(tmp_path) as home:
        guests = [await asyncio.to_thread(Guest, home.path) for _ in range(2)]
        for guest in guests:
            await asyncio.to_thread(guest.read)
        with few_left(4):
            await asyncio.to_thread(guests[0].send, plan(16), files[:16])
            assert await asyncio.to_thread(guests[0].kind) == "protocol"
            await asyncio.to_thread(guests[1].send, PLAN)
            assert "result" in await asyncio.to_thread(guests[1].read)
        for guest in guests:
            guest.close()
        await home.tidy()


@contextlib.contextmanager
def few_left(count: int) -> Iterator[None]:
    """This process may open that many descriptors more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken: list[int] = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (held() + 64, hard))
    try:
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.dup(0))
        for _ in range(count):
            os.close(taken.pop())
        yield
    finally:
        for fd in taken:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


async def test_running_out_of_descriptors_puts_off_who_comes_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connections, "NO_ACCEPT_S", 0.05)

    async with house(tmp_path) as home:
        with socket.socket(socket.AF_UNIX) as late:
            late.setblocking(False)
            with few_left(0):
                late.connect(str(home.path))
                async with asyncio.timeout(PATIENCE_S):
                    while not caplog.records:
                        await asyncio.sleep(0.002)
            async with asyncio.timeout(PATIENCE_S):
                said = await asyncio.get_running_loop().sock_recv(late, 65536)
            assert b"hello" in said
        await home.tidy()
        assert 1 <= len(caplog.records) < 10
