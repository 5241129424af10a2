"""Lines at their limits: ids, hints, codes, and what closes a connection."""

from __future__ import annotations

import json
from typing import Any

import pytest

from pdcd.errors import BusyError, ProtocolError
from pdcd.protocol.messages import MAX_FDS, MAX_LINE
from pdcd.server.descriptors import Descriptors
from pdcd.server.protocol import (
    Connection,
    RpcFault,
    RpcRequest,
    encode_error,
    encode_line,
    encode_notification,
    encode_reply,
    parse_line,
)


def line(method: str = "ping", params: Any = None, **more: Any) -> bytes:
    told = {"jsonrpc": "2.0", "id": 1, "method": method, **more}
    return json.dumps(told if params is None else {**told, "params": params}).encode()


def fault(data: bytes) -> tuple[RpcFault, dict[str, Any]]:
    item = parse_line(data)
    assert isinstance(item, RpcFault) and item.line is not None
    answer: dict[str, Any] = json.loads(item.line)
    assert answer["jsonrpc"] == "2.0" and item.line.endswith(b"\n")
    return item, answer


@pytest.mark.parametrize("good", [0, -1, 2**53 - 1, 1 - 2**53, "", "x" * 128])
def test_ids_that_every_client_can_hold_are_echoed(good: str | int) -> None:
    item = parse_line(line(id=good))
    assert isinstance(item, RpcRequest) and item.id == good
    _, answer = fault(line("nonsense", id=good))
    assert answer["id"] == good


@pytest.mark.parametrize("wrong", [2**53, -(2**53), "x" * 129, 0.5, None, [1], True])
def test_other_ids_are_not(wrong: Any) -> None:
    item, answer = fault(line(id=wrong))
    assert answer["id"] is None and answer["error"]["code"] == -32600 and not item.close


@pytest.mark.parametrize(
    ("data", "code", "request_id"),
    [
        (b"{", -32700, None),
        (b"\xff", -32700, None),
        (b"[" * 5000 + b"]" * 5000, -32700, None),
        (b"[]", -32600, None),
        (b'{"id": 4}', -32600, 4),
        (line(jsonrpc="1.0", id=5), -32600, 5),
        (line("nonsense", id=6), -32601, 6),
        (line("capture.wait", {}, id=7), -32602, 7),
        (line("capture.wait", {"job": 1}, id=8), -32602, 8),
        (line("ping", fds=17), -32600, 1),
    ],
)
def test_each_fault_has_its_code_and_the_id_as_far_as_it_is_sound(
    data: bytes, code: int, request_id: int | None
) -> None:
    item, answer = fault(data)
    assert (answer["error"]["code"], answer["id"]) == (code, request_id)
    assert not item.close and answer["error"]["data"]["hint"]


def test_faults_say_what_a_field_takes() -> None:
    for method, params, says in (
        ("display.show", {"pattern": "code", "index": -1},
         "display.show: index: it takes a whole number from 0 to 2147483647, not -1"),
        ("display.show", {"pattern": "x"},
         "display.show: pattern: it takes black, white, checker, grid, code, projector, mask, "
         'pixels, wedge, star, dots or letter, not "x"'),
        ("capture.start", {"goal": "white", "out": 1}, "capture.start: out: it takes a text"),
        ("capture.wait", {"job": "x" * 65},
         "capture.wait: job: it takes a text of up to 64 characters"),
    ):  # fmt: skip
        _, answer = fault(line(method, params))
        assert answer["error"]["message"] == says
        assert "rig.describe" in answer["error"]["data"]["hint"]


def test_hints_say_which_fields_there_are() -> None:
    hints = {
        "more": fault(line("display.show", {"pattern": "code", "more": 1})),
        "none": fault(line("ping", {"more": 1})),
        "list": fault(line("capture.list", [])),
    }
    told = {name: answer["error"]["data"]["hint"] for name, (_, answer) in hints.items()}
    assert told["more"] == ("fields are: pattern, index, detach; see rig.describe for their types")
    assert told["none"] == "fields are: none; see rig.describe for their types"
    assert told["list"].startswith("fields are: find;")


def test_of_a_clients_own_text_200_letters_are_echoed() -> None:
    for length, echoed in ((200, "x" * 200), (201, "x" * 200 + "...")):
        _, answer = fault(line("x" * length))
        assert answer["error"]["message"] == f"unknown method {echoed}"


def test_a_line_out_may_be_as_long_as_one_in() -> None:
    bare = len(encode_reply(1, ""))
    assert len(encode_reply(1, "x" * (MAX_LINE - bare))) == MAX_LINE
    with pytest.raises(ProtocolError, match=f"the answer is {MAX_LINE + 1} bytes") as caught:
        encode_reply(1, "x" * (MAX_LINE - bare + 1))
    assert caught.value.hint == "read it from the run folder instead"
    assert encode_line({"a": 1}) == b'{"a":1}\n'
    assert json.loads(encode_reply("i", 5)) == {"jsonrpc": "2.0", "id": "i", "result": 5}
    assert json.loads(encode_notification("event", [1])) == {
        "jsonrpc": "2.0", "method": "event", "params": [1],
    }  # fmt: skip
    error = json.loads(encode_error(None, BusyError("x"), 7))["error"]
    assert error == {
        "code": 7,
        "message": "x",
        "data": {"kind": "busy", "device": None, "hint": None},
    }


def test_a_line_that_is_just_too_long_ends_the_connection() -> None:
    connection = Connection(max_line=10)
    assert connection.receive(b" " * 9) == [] and not connection.closed
    (over,) = connection.receive(b" ")
    assert isinstance(over, RpcFault) and over.close and over.line is not None
    assert json.loads(over.line)["error"]["code"] == -32700 and connection.closed
    assert connection.receive(b"\n" + line() + b"\n") == []
    assert Connection(max_line=10).receive(b" " * 9 + b"\n") == []


def test_blank_lines_and_what_follows_them_are_let_pass() -> None:
    connection = Connection()
    found = connection.receive(b"\n \t\r\n" + line(id=1) + b"\n\n" + line(id=2))
    assert [item.id for item in found if isinstance(item, RpcRequest)] == [1]
    (last,) = connection.receive(b"\n")
    assert isinstance(last, RpcRequest) and last.id == 2 and not connection.closed


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
        found = connection.receive(b"")
        assert (len(found), connection.closed) == (int(ends), ends)
        assert held.closed == ([*range(count)] if ends else []) and held.unclaimed == count - len(
            held.closed
        )
    lost = Connection(descriptors=Kept(1))
    (told,) = lost.receive(line() + b"\n", lost=True)
    assert isinstance(told, RpcFault) and told.close and lost.closed
    assert lost.receive(b"", lost=True) == []


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
