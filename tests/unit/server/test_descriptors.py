"""Which descriptors belong to which request: counted right, and each closed once."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.errors import BusyError, ProtocolError
from pdcd.protocol.messages import MAX_FDS, METHODS
from pdcd.server.descriptors import Descriptors
from pdcd.server.protocol import Connection, RpcFault, RpcRequest, parse_line
from tests.unit.server.test_protocol import JSON, line

COUNTED = st.fixed_dictionaries(
    {"jsonrpc": st.just("2.0"), "method": st.sampled_from(["capture.plan", "ping", "nonsense"])},
    optional={
        "id": st.integers(0, 9),
        "params": st.just({"goal": "white"}) | st.just({}),
        "fds": st.integers(0, 4) | st.integers(-1, 20) | JSON,
    },
).map(lambda value: json.dumps(value).encode() + b"\n")
PIECES = st.lists(
    st.tuples(
        COUNTED | COUNTED | COUNTED | st.binary(max_size=9), st.integers(0, 6), st.booleans()
    ),
    max_size=12,
)


class Ledger:
    """Stands for the kernel: gives out descriptors, and takes each back once."""

    def __init__(self) -> None:
        self.given = 0
        self.open: set[int] = set()

    def give(self, count: int) -> list[int]:
        fresh = list(range(self.given, self.given + count))
        self.given += count
        self.open.update(fresh)
        return fresh

    def close(self, fds: tuple[int, ...]) -> asyncio.Task[None]:
        assert len(set(fds)) == len(fds) and self.open >= set(fds), "closed twice"
        self.open.difference_update(fds)
        return asyncio.create_task(asyncio.sleep(0))


@settings(max_examples=100)
@given(PIECES, st.booleans())
def test_no_descriptor_is_lost_or_closed_twice(
    pieces: list[tuple[bytes, int, bool]], answered: bool
) -> None:
    async def scenario() -> None:
        ledger = Ledger()
        descriptors = Descriptors(ledger.close)
        connection = Connection(4096, descriptors)
        held: list[int] = []
        for data, count, cut_off in pieces:
            fresh = ledger.give(count)
            descriptors.receive(fresh)
            for item in connection.receive(data, lost=cut_off and count == 6):
                if isinstance(item, RpcFault):
                    assert item.error.kind in ("request", "protocol", "busy")
                    continue
                assert set(item.fds) <= ledger.open and not set(item.fds) & set(held)
                assert METHODS[item.method].takes_fds or not item.fds
                if answered:
                    descriptors.release(item.fds)
                else:
                    held += item.fds
                    assert len(held) <= MAX_FDS
            assert descriptors.unclaimed <= MAX_FDS
            assert not connection.closed or descriptors.unclaimed == 0
            await descriptors.settle(1.0)
        assert len(ledger.open) == descriptors.unclaimed + len(held)
        await descriptors.end()
        assert not ledger.open

    asyncio.run(scenario())


class Kept(Descriptors):
    """Descriptors whose closing is noted, not done."""

    def __init__(self, *came: int) -> None:
        super().__init__(self._note)
        self.closed: list[int] = []
        self.receive(came)

    def _note(self, fds: tuple[int, ...]) -> Any:
        self.closed += fds

        class Done:
            def add_done_callback(self, _: Any) -> None:
                pass

        return Done()


def test_a_client_that_sends_too_many_descriptors_is_parted_from() -> None:
    for count, ends in ((MAX_FDS, False), (MAX_FDS + 1, True)):
        held = Kept(*range(count))
        connection = Connection(descriptors=held)
        found = [*connection.receive(b"")]
        assert (len(found), connection.closed) == (int(ends), ends)
        assert held.closed == ([*range(count)] if ends else []) and held.unclaimed == count - len(
            held.closed
        )
    lost = Connection(descriptors=Kept(1))
    (told,) = lost.receive(line() + b"\n", lost=True)
    assert isinstance(told, RpcFault) and told.close and lost.closed
    assert [*lost.receive(b"", lost=True)] == []


@pytest.mark.parametrize(
    ("data", "ends"),
    [
        (b"{", True), (b"[]", True), (b'{"id": 1}', True), (line("ping", fds=3), True),
        (line("ping", fds=2), False), (line("nonsense", fds=1), False),
        (line("capture.plan", {}, fds=1), False),
    ],
)  # fmt: skip
def test_whose_descriptors_are_in_doubt_is_parted_from(data: bytes, ends: bool) -> None:
    held = Kept(70, 71)
    connection = Connection(descriptors=held)
    (item,) = connection.receive(data + b"\n")
    assert isinstance(item, RpcFault) and item.close is connection.closed is ends
    taken = json.loads(data).get("fds", 0) if not ends else 2
    assert held.closed == [70, 71][:taken] and held.unclaimed == 2 - taken


def test_a_plan_takes_what_it_names_and_leaves_the_rest() -> None:
    held = Kept(70, 71, 72)
    item = parse_line(line("capture.plan", {"goal": "white"}, fds=2), held)
    assert isinstance(item, RpcRequest) and item.fds == (70, 71)
    assert held.unclaimed == 1 and held.closed == []
    held.release((70, 71, 99))
    assert held.closed == [70, 71]  # and no other's
    held.release((70,))
    assert held.closed == [70, 71]
    held.close()
    assert held.closed == [70, 71, 72] and held.unclaimed == 0


def test_requests_hold_16_descriptors_at_most() -> None:
    held = Kept(*range(17))
    assert held.take(16) == tuple(range(16)) and held.take(0) == ()
    with pytest.raises(BusyError, match="more than 16") as caught:
        held.take(1)
    assert held.closed == [16] and caught.value.hint
    with pytest.raises(ProtocolError, match="names 1 descriptors, 0 came"):
        held.take(1)
