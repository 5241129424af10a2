"""Requests of many connections: whose line is next, how much may be unanswered, and what a line
leaves behind. Order and bytes are told, no times."""

from __future__ import annotations

import asyncio
import gc
import json
import tracemalloc
import weakref
from collections.abc import Callable
from typing import Any, cast

import pytest

from pdcd.errors import DeniedError
from pdcd.protocol.fields import decode_struct
from pdcd.protocol.messages import MAX_LINE, NoParams
from pdcd.protocol.views import ClientRole
from pdcd.server import protocol, reading
from pdcd.server.access import Peer
from pdcd.server.callers import Caller
from pdcd.server.descriptors import Descriptors
from pdcd.server.protocol import RpcFault, RpcRequest, parse_line
from pdcd.server.reading import OPEN_BYTES, FairShares, RequestReader
from pdcd.server.stream import ReceivedData, Stream
from tests.processes import LONG_S

EVE, ANNA = 1001, 1002


class Far:
    """A client whose lines are all there already, and which stays."""

    is_cut = False

    def __init__(self, data: bytes) -> None:
        self.pieces = [data[at : at + 65536] for at in range(0, len(data), 65536)]
        self.told: list[dict[str, Any]] = []

    async def receive(self) -> ReceivedData:
        await asyncio.sleep(0)
        return ReceivedData(self.pieces.pop(0) if self.pieces else b"", [], False)

    async def send(self, line: bytes, fd: int | None = None) -> None:
        self.told.append(json.loads(line))


class Service:
    """Notes who asked for what, in order; `until` holds answers back."""

    def __init__(self) -> None:
        self.order: list[tuple[int, str]] = []
        self.until = asyncio.Event()
        self.until.set()

    def permit(self, caller: Caller, method: str) -> None:
        if caller.role is ClientRole.LOOK and method == "capture.start":
            raise DeniedError("no", hint="ask")

    async def handle(self, caller: Caller, request: RpcRequest) -> Any:
        self.order.append((caller.peer.uid, request.method))
        await self.until.wait()
        return NoParams()


class House:
    """Connections that share turns."""

    def __init__(self) -> None:
        self.service, self.shares = Service(), FairShares()

    def let_in(self, uid: int, *lines: bytes, role: ClientRole = ClientRole.SHOOT) -> Any:
        far = Far(b"".join(line + b"\n" for line in lines))
        caller = Caller(uid, Peer(1, uid, uid, "who"), role, cast(Stream, far))
        reader = RequestReader(
            cast(Any, self.service), caller, cast(Stream, far), Descriptors(), self.shares
        )
        return far, caller, reader

    async def read(self, *come: Any) -> None:
        """Read all of them at the same time, to the end."""
        pumps = [asyncio.create_task(caller.pump()) for _, caller, _ in come]
        async with asyncio.timeout(LONG_S):
            await asyncio.gather(*(reader.read() for *_, reader in come))
            self.service.until.set()
            while any(reader.open for *_, reader in come):
                await asyncio.sleep(0)
            for _, caller, _ in come:
                caller.finish()
            await asyncio.gather(*pumps)


def line(method: str, **params: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode()


@pytest.mark.parametrize(
    "flood", [line("ping"), line("capture.start", codes=0), b"nonsense", line("ping") + b"\n" * 50]
)
async def test_a_thousand_lines_of_one_user_are_one_line_before_anothers(flood: bytes) -> None:
    looked: list[int] = []
    house = House()
    machine = house.let_in(EVE, *[flood] * 1000)
    honest = house.let_in(ANNA, *[line("rig.status")] * 3)
    begin = RequestReader._begin

    def noted(self: RequestReader, item: Any, size: int) -> None:
        looked.append(self._caller.peer.uid)
        begin(self, item, size)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RequestReader, "_begin", noted)
        await house.read(machine, honest)
    assert looked.count(EVE) == 1000 and looked.count(ANNA) == 3
    last = len(looked) - 1 - looked[::-1].index(ANNA)
    assert last < 10  # two of Eve's lines at most between two of Anna's
    assert [uid for uid, _ in house.service.order if uid == ANNA] == [ANNA] * 3


async def test_a_request_that_is_refused_is_not_kept() -> None:
    """Not even until the next search for circles: lines may have a megabyte each."""
    house, held = House(), []

    class Large:
        pass

    async def refuse(caller: Caller, request: RpcRequest) -> Any:
        large = Large()
        held.append(weakref.ref(large))
        raise DeniedError("no", hint="ask")

    house.service.handle = refuse  # type: ignore[method-assign]
    gc.disable()
    try:
        await house.read(house.let_in(EVE, line("ping")))
        assert [ref() for ref in held] == [None]
    finally:
        gc.enable()


async def test_who_sends_long_lines_rests_and_has_only_so_many_unanswered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rests: list[float] = []
    house = House()
    give_back = house.shares.lines.give_back

    def noted(uid: int, rest_s: float = 0.0) -> None:
        rests.append(rest_s)
        give_back(uid)

    monkeypatch.setattr(house.shares.lines, "give_back", noted)
    house.service.until.clear()
    long = line("capture.plan", goal="white", note="", kernel=[[1.0] * 200_000])
    eve = house.let_in(EVE, *[long] * 4)
    anna = house.let_in(ANNA, long)
    await house.read(eve, anna)
    fits = OPEN_BYTES // len(long)
    kinds = ["error" in told for told in eve[0].told]
    assert 1 < fits < 4 and sorted(kinds) == [False] * fits + [True] * (4 - fits)
    (error,) = {told["error"]["message"] for told in eve[0].told if "error" in told}
    assert error == f"more than {OPEN_BYTES} bytes of requests of this user are unanswered"
    assert "error" not in anna[0].told[0] and not house.shares.open_bytes
    assert sorted(rests)[-5:] == [reading._REST_S * len(long) / MAX_LINE] * 5


def wide(count: int) -> bytes:
    return b"{" + b",".join(b'"m%d":%d' % (n, n) for n in range(count)) + b"}"


HOSTILE: list[tuple[str, Callable[[], bytes], str]] = [
    ("members that nobody knows", lambda: wide(70_000), "unknown field"),
    ("members within a field", lambda: b'{"goal":' + wide(70_000) + b"}", "goal: it takes"),
    ("an array of arrays", lambda: b'{"goal":"white","seed":[' + b"[]," * 300_000 + b"0]}", "seed"),
    ("a deep one", lambda: b'{"goal":' + b"[" * 400_000 + b"]" * 400_000 + b"}", "not a JSON text"),
    ("a long text", lambda: b'{"goal":"' + b"x" * 900_000 + b'"}', "goal: it takes"),
    ("the same member", lambda: b'{"goal":1' + b',"goal":1' * 90_000 + b"}", "goal: it takes"),
    ("numbers without end", lambda: b'{"goal":"white","seed":' + b"9" * 900_000 + b"}", "seed"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "made", "words"), HOSTILE)
async def test_of_a_hostile_line_nothing_is_made_and_nothing_kept(
    name: str, made: Callable[[], bytes], words: str
) -> None:
    data = b'{"jsonrpc":"2.0","id":1,"method":"capture.start","params":' + made() + b"}"
    assert len(data) < MAX_LINE
    house = House()
    far, caller, reader = house.let_in(EVE, data)
    pump = asyncio.create_task(caller.pump())
    await asyncio.sleep(0)
    parse_line(line("capture.start", x=1))  # what is made once is there
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    items = reader._machine.receive(b"".join(far.pieces))
    far.pieces.clear()
    assert await reader._take_line(items) and not await reader._take_line(items)
    after, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # The bytes as they come, as they wait and as a line, and a text. With all members made it was
    # 8.6 of the first line, and all of it was kept until the next one.
    assert peak - before < 7 * len(data)
    assert after - before < len(data) // 4 + 100_000
    caller.finish()
    await pump
    assert words in far.told[0]["error"]["message"]


async def test_who_may_not_ask_is_told_so_before_the_parameters_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looked: list[Any] = []

    def noted(*given: Any) -> Any:
        looked.append(given)
        return decode_struct(*given)

    monkeypatch.setattr(protocol, "decode_struct", noted)
    house = House()
    wrong = line("capture.start", goal="sideways")
    eve = house.let_in(EVE, wrong, role=ClientRole.LOOK)
    await house.read(eve)
    assert eve[0].told[0]["error"]["data"]["kind"] == "denied" and not looked
    anna = house.let_in(ANNA, wrong)
    await house.read(anna)
    assert anna[0].told[0]["error"]["data"]["kind"] == "request" and len(looked) == 1
    assert isinstance(parse_line(wrong), RpcFault)
