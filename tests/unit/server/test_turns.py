"""Who is served next: told by the order of service. Work takes as long as the test says."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pdcd.server.turns import UserTurns

EVE, ANNA, BERT = 1, 2, 3


class Work:
    """Work for users that ends when the test says so; `order` is who was served."""

    def __init__(self, **places: int) -> None:
        self.turns = UserTurns(**places)
        self.order: list[int] = []
        self.busy: dict[asyncio.Event, int] = {}
        self.tasks: list[asyncio.Task[None]] = []

    async def _do(self, uid: int) -> None:
        await self.turns.take(uid)
        try:
            self.order.append(uid)
            done = asyncio.Event()
            self.busy[done] = uid
            await done.wait()
            del self.busy[done]
        finally:
            self.turns.give_back(uid)

    async def ask(self, *uids: int) -> None:
        self.tasks += [asyncio.create_task(self._do(uid)) for uid in uids]
        await settle()

    async def end_one(self) -> None:
        next(iter(self.busy)).set()
        await settle()

    async def end_all(self) -> list[int]:
        while self.busy:
            await self.end_one()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        assert not self.turns._held and not self.turns._waiting
        return self.order


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


@pytest.mark.parametrize(
    ("places", "asked", "order"),
    [
        # A thousand of one user are no more in another's way than two are.
        ({}, [EVE] * 1000 + [ANNA, BERT, ANNA], [EVE, ANNA, BERT, EVE, ANNA] + [EVE] * 998),
        ({}, [EVE, EVE, EVE], [EVE] * 3),
        ({"each": 2, "total": 3}, [EVE] * 4 + [ANNA] * 3,
         [EVE, EVE, ANNA, ANNA, EVE, EVE, ANNA]),
        ({"each": 1, "total": 8}, [EVE, EVE, ANNA], [EVE, ANNA, EVE]),
    ],
)  # fmt: skip
async def test_users_are_served_in_turn_and_each_in_order(
    places: Any, asked: list[int], order: list[int]
) -> None:
    work = Work(**places)
    await work.ask(*asked)
    assert await work.end_all() == order


async def test_who_comes_while_another_is_served_is_next() -> None:
    work = Work()
    await work.ask(EVE, EVE, EVE)
    await work.ask(ANNA)
    assert await work.end_all() == [EVE, ANNA, EVE, EVE]


async def test_who_leaves_while_waiting_or_just_then_takes_no_place() -> None:
    work = Work()
    await work.ask(EVE, ANNA, BERT)
    work.tasks[1].cancel()
    await settle()
    next(iter(work.busy)).set()
    await asyncio.sleep(0)  # the place is being handed to Bert
    work.tasks[2].cancel()
    await settle()
    assert work.order == [EVE] and not work.turns._held
    await work.ask(ANNA)
    assert await work.end_all() == [EVE, ANNA]


async def test_a_user_who_rests_gives_the_place_to_others_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rests: list[tuple[float, Any]] = []
    loop = asyncio.get_running_loop()
    monkeypatch.setattr(loop, "call_later", lambda s, call, *a: rests.append((s, lambda: call(*a))))
    turns = UserTurns()
    await turns.take(EVE)
    waiting = [asyncio.create_task(turns.take(uid)) for uid in (EVE, ANNA)]
    await settle()
    turns.give_back(EVE, 0.1)
    await settle()
    assert [task.done() for task in waiting] == [False, True] and rests[0][0] == 0.1
    turns.give_back(ANNA)
    await settle()
    assert not waiting[0].done()
    rests[0][1]()
    await settle()
    assert waiting[0].done()
    turns.give_back(EVE)
    assert not turns._held
