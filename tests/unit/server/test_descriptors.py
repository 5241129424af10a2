"""Which descriptors belong to which request: counted right, and each closed once."""

from __future__ import annotations

import asyncio
import json

from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.protocol.messages import MAX_FDS, METHODS
from pdcd.server.descriptors import Descriptors
from pdcd.server.protocol import Connection, RpcFault
from tests.unit.server.test_protocol import JSON

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
