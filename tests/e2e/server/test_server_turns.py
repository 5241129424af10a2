"""Users take turns at what takes long, told by the order in which it is done."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest

from pdcd.bench.tables import RoleConfig, ServerConfig
from pdcd.protocol.entry import Page, RunQuery
from pdcd.server import methods
from tests.e2e.server._server_harness import Daemon, Wire, served
from tests.e2e.server._users import ANNA, BERT, Users

LOOKERS = ServerConfig(look=RoleConfig(uids=(ANNA, BERT)))


@served(server=LOOKERS)
async def test_a_flood_of_lists_of_one_user_is_one_list_before_anothers(
    running: Daemon, users: Users, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[int] = []
    going_on = threading.Semaphore(0)

    def slow(state: Path, query: RunQuery) -> Page:
        order.append(query.newest)
        assert going_on.acquire(timeout=20.0)
        return Page(state_folder=str(state), runs=[])

    monkeypatch.setattr(methods, "search_runs", slow)
    users.become(ANNA)
    async with running.wire() as flood, running.wire() as more:
        for number in range(20):
            asks = {"jsonrpc": "2.0", "id": number, "method": "capture.list"}
            for wire in (flood, more):
                await wire.send({**asks, "params": {"find": {"newest": 1}}})
        while not order:
            await asyncio.sleep(0.001)
        users.become(BERT)
        async with running.wire() as honest:
            for _ in range(2):
                wanted = asyncio.create_task(honest.result("capture.list", find={"newest": 2}))
                await asyncio.sleep(0.05)  # until it waits
                while not wanted.done():
                    going_on.release()
                    await asyncio.sleep(0.01)
                assert (await wanted)["found"]["runs"] == []
        assert order.count(2) == 2 and order.index(2) == 1 and len(order) <= 6
        going_on.release(60)
        for wire in (flood, more):
            assert "result" in await wire.answer(19)


@served
async def test_many_questions_about_the_rig_are_one_to_the_engine(
    running: Daemon, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They must not line up before a job."""
    answers, describe = threading.Event(), running.engine.describe
    asked: list[int] = []

    def slow() -> object:
        asked.append(1)
        assert answers.wait(20.0)
        return describe()

    monkeypatch.setattr(running.engine, "describe", slow)
    for number in range(30):
        await wire.send({"jsonrpc": "2.0", "id": number, "method": "rig.describe"})
    assert "result" in await wire.answer(29) and len(asked) == 1
    answers.set()
    assert "result" in await wire.answer(0) and len(asked) == 1
