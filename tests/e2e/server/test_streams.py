"""A stream over the socket: its pictures in memory that is passed, who may have them, its end."""

from __future__ import annotations

import asyncio
import base64
import os
import socket
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.api.stream import ConnectedStream
from pdcd.client import Client
from pdcd.errors import Cancelled, RequestError
from pdcd.files.parcels import pack_arrays, unpack_arrays
from pdcd.protocol.stream import StreamRequest
from tests.e2e.server._server_harness import Daemon, Wire, served
from tests.processes import soon


async def in_thread(function: Any, *args: Any) -> Any:
    return await asyncio.to_thread(function, *args)


def wait_until_let_go() -> None:
    """Of both sides, which are this process: no memory of pictures is kept."""
    assert soon(lambda: not any(map(_is_memory, Path("/proc/self/fd").iterdir())))


def _is_memory(path: Path) -> bool:
    try:
        return "pdcd-arrays" in str(path.readlink())
    except OSError:
        return False


@served
async def test_pictures_come_as_memory_that_nobody_can_change(running: Daemon, wire: Wire) -> None:
    def look() -> None:
        with Client(running.path) as client:
            job = client.start_stream(StreamRequest(goal="indirect"))
            number = 0
            for _ in range(30):
                seen = client.see_stream(job, number)
                assert seen.number > number
                number = seen.number
                if seen.frame.spoilt:
                    assert seen.number % 10 == 0 and not seen.arrays
                    continue
                assert seen.arrays["image"].shape == (2, 3, 1)
                assert (seen.arrays["picture"] == float(number)).all()
            assert not client.see_stream(job, number, "none").arrays
            while not (drawn := client.see_stream(job, number, "jpeg").frame).jpeg:
                number = drawn.number
            assert drawn.jpeg == b"picture" and not drawn.arrays
            made = client.record_stream(job)
            assert (made.state, made.folder) == ("done", "/nowhere") and made.job != job
            assert client.cancel(job).state == "cancelled"
            with pytest.raises(Cancelled):
                client.see_stream(job, number)
            with pytest.raises(RequestError, match="has ended"):
                client.record_stream(job)
        wait_until_let_go()

    await in_thread(look)
    (view,) = (await wire.result("capture.list"))["jobs"]
    assert (view["kind"], view["goal"], view["state"]) == ("stream", "indirect", "cancelled")


@served
async def test_the_newest_counts_for_who_is_slow_and_time_ends_it(
    running: Daemon, wire: Wire
) -> None:
    def look() -> list[int]:
        with Client(running.path) as client:
            job = client.start_stream(StreamRequest(goal="direct", for_s=0.1))
            numbers = []
            for picture in ConnectedStream(client, job):
                numbers.append(picture.number)
                client.call("ping")
            return numbers

    numbers = await in_thread(look)
    assert numbers == sorted(set(numbers)) and not any(number % 10 == 0 for number in numbers)


@served
async def test_it_is_a_job_like_others_and_refused_like_them(
    running: Daemon, wire: Wire, other: Wire
) -> None:
    for wrong in ({"over": 9}, {"error": 0.01}, {"parts": 2}, {"pilot": "auto"}, {"rate_hz": 0}):
        assert (await wire.error("stream.start", goal="indirect", **wrong))["data"][
            "kind"
        ] == "request"
    job = (await wire.result("stream.start", goal="indirect"))["job"]
    assert (await other.error("capture.start", goal="white"))["data"]["kind"] == "busy"
    frame = await other.result("stream.frame", job=job, picture="jpeg")
    frame = await other.result("stream.frame", job=job, picture="jpeg", after=frame["number"])
    assert base64.b64decode(frame["jpeg"]) in (b"picture", b"")
    assert (await wire.error("preview.frame", job=job))["data"]["kind"] == "request"
    waits = asyncio.create_task(wire.ask("stream.frame", job=job, after=2**40))
    assert (await other.result("capture.cancel", job=job))["state"] == "cancelled"
    assert (await waits)["error"]["data"]["kind"] == "cancelled"
    shown = await wire.result("display.show", pattern="black")
    for method in ("stream.frame", "stream.record"):
        assert (await wire.error(method, job=shown["job"]))["data"]["kind"] == "request"


@served
async def test_it_ends_with_its_connection(running: Daemon, wire: Wire) -> None:
    async with running.wire() as gone:
        job = (await gone.result("stream.start", goal="indirect"))["job"]
        await gone.result("stream.frame", job=job)
    assert (await wire.result("capture.wait", job=job))["state"] == "cancelled"


@served
async def test_who_does_not_read_keeps_no_memory(running: Daemon, wire: Wire) -> None:
    def ask_and_leave() -> None:
        with socket.socket(socket.AF_UNIX) as deaf:
            deaf.connect(str(running.path))
            start = {"jsonrpc": "2.0", "id": 1, "method": "stream.start"}
            deaf.sendall(msgspec.json.encode({**start, "params": {"goal": "white"}}) + b"\n")
            seen = b""
            while b'"id":1' not in seen:
                seen += deaf.recv(65536)
            job = msgspec.json.decode(seen.split(b"\n")[-2])["result"]["job"]
            for number in range(40):
                params = {"job": job, "after": 0, "picture": "arrays"}
                asked = {"jsonrpc": "2.0", "id": 2 + number, "method": "stream.frame"}
                deaf.sendall(msgspec.json.encode({**asked, "params": params}) + b"\n")
            assert b'"fds":1' in deaf.recv(2**20)  # what came with it was not wanted
        wait_until_let_go()

    await in_thread(ask_and_leave)
    assert (await wire.result("rig.status"))["connections"] == 1


def test_what_does_not_lie_in_the_memory_is_refused() -> None:
    fd, places = pack_arrays({})
    os.close(fd)
    array = np.arange(12.0).reshape(3, 4)
    fd, places = pack_arrays({"a": array, "b": array[:, ::2].astype(np.float32)})
    try:
        found = unpack_arrays(fd, places.items())
        assert (found["a"] == array).all() and (found["b"] == array[:, ::2]).all()
        for wrong in (
            ("<f8", (2**40,), 0), ("<f8", (3, 4), 128), ("<f8", (-1,), 0), ("<f8", (3, 4), -8),
            ("|O", (1,), 0), ("<f8", (1, 1, 1, 1), 0),
        ):  # fmt: skip
            with pytest.raises(ValueError):
                unpack_arrays(fd, [("x", wrong)])
        with pytest.raises(OSError):
            os.pwrite(fd, b"x", 0)
        with pytest.raises(OSError):
            os.ftruncate(fd, 0)
    finally:
        os.close(fd)
