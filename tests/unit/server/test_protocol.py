"""The codec: what is answered to which bytes, and that no bytes make it raise."""

from __future__ import annotations

import json
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.errors import KINDS, BusyError, PdcdError, ProtocolError, to_error_fields
from pdcd.protocol import messages
from pdcd.protocol.messages import CODES, METHODS, JobParams, StartParams
from pdcd.protocol.request import CaptureRequest
from pdcd.server.protocol import (
    Connection,
    RpcFault,
    RpcRequest,
    encode_error,
    encode_notification,
    encode_reply,
    parse_line,
)
from pdcd.words import GoalName


def line(method: str, params: Any = None, **envelope: Any) -> bytes:
    """A request line, without its newline."""
    message = {"jsonrpc": "2.0", "id": 1, "method": method, **envelope}
    if params is not None:
        message["params"] = params
    return json.dumps(message).encode()


def fault(data: bytes) -> tuple[RpcFault, dict[str, Any]]:
    """The fault that a line is, and its answer read by another JSON reader."""
    item = parse_line(data)
    assert isinstance(item, RpcFault)
    assert item.line is not None
    assert item.line.endswith(b"\n") and item.line.count(b"\n") == 1
    return item, json.loads(item.line)


def test_a_request_becomes_its_typed_parameters() -> None:
    item = parse_line(
        line("capture.start", {"goal": "indirect", "codes": 8, "queue": True}, id="a")
    )
    assert isinstance(item, RpcRequest)
    assert (item.id, item.method) == ("a", "capture.start")
    assert isinstance(item.params, StartParams)
    assert item.params.request() == CaptureRequest(goal="indirect", codes=8)
    assert item.params.queue and not item.params.detach


def test_the_request_keeps_every_field_of_the_wire() -> None:
    given = {
        "goal": "fraction",
        "codes": 5,
        "family": "balanced",
        "p": 0.5,
        "shift": (1, -2),
        "radius": 2,
        "mix": (0.5, -1.0),
        "period": 8,
        "disparity": (-1, 2),
        "plane": (1.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        "keep": "out",
        "rows": (3, 4),
        "masked": True,
        "equal_brightness": True,
        "illumination": "light.npy",
        "warp": "warp.npy",
        "warp_b": ((1.0, 0.0),),
        "region_a": "a.png",
        "region_b": "b.png",
        "disparities": "disparities.npy",
        "kernel": ((1.0,),),
        "matrix": "matrix.npy",
        "method": "nayar",
        "pilot": 4,
        "smooth": True,
        "grey_masks": False,
        "parts": 2,
        "until_error": 0.01,
        "repeat": 3,
        "error": 0.02,
        "confidence": 0.9,
        "seconds": 30.0,
        "prior": "prior.npz",
        "seed": 9,
        "exposure_s": 2.5,
        "window": "quarter",
        "guards": False,
        "black_level": "both",
        "normalise": "row",
        "white": False,
        "white_patch": (0.25, 1.0),
        "out": "here",
        "name": "a chart",
        "tags": ("glass",),
        "note": "n",
    }
    assert set(given) == set(CaptureRequest.__struct_fields__)
    item = parse_line(line("capture.start", given))
    assert isinstance(item, RpcRequest) and isinstance(item.params, StartParams)
    made = item.params.request()
    assert {name: getattr(made, name) for name in given} == given


def test_parameters_may_be_left_out_where_none_are_needed() -> None:
    item = parse_line(line("ping"))
    assert isinstance(item, RpcRequest) and item.method == "ping"


def test_a_notification_has_no_id_and_its_fault_no_answer() -> None:
    item = parse_line(b'{"jsonrpc":"2.0","method":"ping"}')
    assert isinstance(item, RpcRequest) and item.id is None
    item = parse_line(b'{"jsonrpc":"2.0","method":"nonsense"}')
    assert isinstance(item, RpcFault) and item.line is None


@pytest.mark.parametrize(
    "data",
    [
        b"{",
        b"nonsense",
        b'{"jsonrpc":"2.0","id":1,"method":"ping"} trailing',
        b'{"jsonrpc":"2.0","id":1,"method":"capture.start","params":{"exposure_s":NaN}}',
        b'{"jsonrpc":"2.0","id":1,"method":"capture.start","params":{"exposure_s":Infinity}}',
        b'{"jsonrpc":"2.0","id":1,"method":"capture.start","params":{"exposure_s":1e999}}',
        b'{"jsonrpc":"2.0","id":1,"method":"\xff"}',
        b'{"jsonrpc":"2.0","id":1,"method":"\\ud800"}',
        b"[" * 200_000,
        b"9" * 5000,
    ],
)
def test_what_is_no_json_is_a_parse_error_without_id(data: bytes) -> None:
    item, answer = fault(data)
    assert not item.close
    assert answer["id"] is None
    assert answer["error"]["code"] == -32700
    assert answer["error"]["data"]["kind"] == "protocol"


@pytest.mark.parametrize(
    ("data", "request_id"),
    [
        (b'[{"jsonrpc":"2.0","id":1,"method":"ping"}]', None),
        (b"[]", None),
        (b"1", None),
        (b"null", None),
        (b"{}", None),
        (b'{"jsonrpc":"2.0","id":7}', 7),
        (b'{"jsonrpc":"1.0","id":7,"method":"ping"}', 7),
        (b'{"id":7,"method":"ping"}', 7),
        (b'{"jsonrpc":"2.0","id":"x","method":5}', "x"),
        (b'{"jsonrpc":"2.0","id":null,"method":"ping"}', None),
        (b'{"jsonrpc":"2.0","id":1.5,"method":"ping"}', None),
        (b'{"jsonrpc":"2.0","id":true,"method":"ping"}', None),
        (b'{"jsonrpc":"2.0","id":[1],"method":"ping"}', None),
        (b'{"jsonrpc":"2.0","id":9007199254740992,"method":"ping"}', None),
        (b'{"jsonrpc":"2.0","id":"' + b"x" * 129 + b'","method":"ping"}', None),
        (b'{"jsonrpc":"2.0","id":3,"result":{}}', 3),
    ],
)
def test_what_is_no_request_is_an_invalid_request(data: bytes, request_id: object) -> None:
    _, answer = fault(data)
    assert answer["id"] == request_id
    assert answer["error"]["code"] == -32600
    assert answer["error"]["data"]["kind"] == "protocol"


def test_an_unknown_method_is_answered_with_the_known_ones() -> None:
    _, answer = fault(line("capture.erase"))
    assert answer["error"]["code"] == -32601
    assert answer["error"]["data"]["kind"] == "protocol"
    assert "capture.start" in answer["error"]["data"]["hint"]
    _, answer = fault(line("m" * 100_000))
    assert len(json.dumps(answer)) < 2000


@pytest.mark.parametrize(
    ("method", "params", "named"),
    [
        ("capture.start", {}, "goal"),
        ("capture.start", {"goal": "sideways"}, "goal"),
        ("capture.start", {"goal": "white", "family": "random"}, "family"),
        ("capture.start", {"goal": "white", "codes": 0}, "codes"),
        ("capture.start", {"goal": "white", "codes": 65537}, "codes"),
        ("capture.start", {"goal": "white", "codes": "8"}, "codes"),
        ("capture.start", {"goal": "white", "codes": 8.0}, "codes"),
        ("capture.start", {"goal": "white", "codes": True}, "codes"),
        ("capture.start", {"goal": "white", "seed": -1}, "seed"),
        ("capture.start", {"goal": "white", "seed": 2**53}, "seed"),
        ("capture.start", {"goal": "white", "seed": 10**30}, "seed"),
        ("capture.start", {"goal": "fraction", "p": 1}, "p"),
        ("capture.start", {"goal": "white", "exposure_s": 0}, "exposure_s"),
        ("capture.start", {"goal": "white", "code": 8}, "code"),
        ("capture.start", {"goal": "white", "detach": 1}, "detach"),
        ("capture.start", {"goal": "white", "note": "x" * 4097}, "note"),
        ("capture.plan", {"goal": "white", "detach": True}, "detach"),
        ("capture.wait", {}, "job"),
        ("capture.wait", {"job": 7}, "job"),
        ("capture.cancel", {"job": "x" * 65}, "job"),
        ("display.show", {"pattern": "stripes"}, "pattern"),
        ("display.show", {"pattern": "code", "index": -1}, "index"),
        ("events.subscribe", {"jobs": "some"}, "jobs"),
        ("ping", {"loud": True}, "loud"),
        ("hello", {"protocol": [1]}, "protocol"),
    ],
)
def test_a_wrong_parameter_is_named(method: str, params: dict[str, Any], named: str) -> None:
    _, answer = fault(line(method, params))
    assert answer["id"] == 1
    assert answer["error"]["code"] == -32602
    assert answer["error"]["data"]["kind"] == "request"
    message = answer["error"]["message"]
    assert f" {named}: it takes" in message or f"`{named}`" in message


@pytest.mark.parametrize("params", [None, [], ["white"], "white", 3])
def test_parameters_must_be_an_object(params: object) -> None:
    message = {"jsonrpc": "2.0", "id": 1, "method": "capture.start", "params": params}
    _, answer = fault(json.dumps(message).encode())
    assert answer["error"]["code"] == -32602


def test_what_a_field_takes_is_said() -> None:
    _, answer = fault(line("capture.start", {"goal": "sideways"}))
    for goal in ("white", "indirect", "direct", "fraction"):
        assert goal in answer["error"]["message"]
    _, answer = fault(line("capture.start", {"goal": "white", "colour": 1}))
    assert "codes" in answer["error"]["data"]["hint"]


@pytest.mark.parametrize(
    ("wanted", "agreed"),
    [
        ([1, 0], True),
        ([1, 1], False),
        ([0, 9], False),
        ([2, 0], False),
    ],
)
def test_hello_closes_on_a_version_that_is_not_spoken(wanted: list[int], agreed: bool) -> None:
    connection = Connection()
    (item,) = connection.receive(line("hello", {"protocol": wanted}) + b"\n")
    assert isinstance(item, RpcRequest) is agreed
    assert connection.closed is not agreed
    assert len(connection.receive(line("ping") + b"\n")) == (1 if agreed else 0)


def test_lines_are_found_whatever_the_cut() -> None:
    stream = b"".join(line("ping", id=k) + ending for k, ending in enumerate([b"\n", b"\r\n"] * 3))
    whole = Connection().receive(b"\n  \n" + stream)
    assert [item.id for item in whole if isinstance(item, RpcRequest)] == [0, 1, 2, 3, 4, 5]
    connection = Connection()
    single = [item for k in range(len(stream)) for item in connection.receive(stream[k : k + 1])]
    assert single == whole


def test_a_line_of_exactly_the_limit_passes_and_one_byte_more_does_not() -> None:
    frame = line("capture.start", {"goal": "white", "note": ""})
    limit = 4000
    for extra, passes in ((0, True), (1, False)):
        note = "x" * (limit - 1 - len(frame) + extra)
        data = line("capture.start", {"goal": "white", "note": note}) + b"\n"
        assert len(data) == limit + extra
        connection = Connection(max_line=limit)
        items = connection.receive(data + line("ping") + b"\n")
        assert isinstance(items[0], RpcRequest) is passes
        assert connection.closed is not passes
        if not passes:
            (over,) = items
            assert isinstance(over, RpcFault) and over.close and over.line is not None
            assert json.loads(over.line)["error"]["data"]["kind"] == "protocol"


def test_an_endless_line_is_refused_before_it_fills_the_memory() -> None:
    connection = Connection()
    chunk = b"x" * 65536
    found: list[RpcRequest | RpcFault] = []
    for _ in range(64):
        found += connection.receive(chunk)
        assert len(connection._rest) <= messages.MAX_LINE
    assert len(found) == 1 and connection.closed


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=10,
)
FIELDS = [*CaptureRequest.__struct_fields__, "detach", "queue", "job", "jobs", "pattern"]
NEARLY = st.fixed_dictionaries(
    {},
    optional={
        "jsonrpc": st.just("2.0") | JSON,
        "id": st.integers(0, 9) | JSON,
        "method": st.sampled_from(sorted(METHODS)) | JSON,
        "params": st.dictionaries(st.sampled_from(FIELDS) | st.text(max_size=6), JSON) | JSON,
        "fds": st.integers(-1, 20) | JSON,
    },
).map(lambda value: json.dumps(value).encode())


@settings(deadline=None, derandomize=True, max_examples=20)
@given(st.lists(st.binary(max_size=200) | NEARLY | NEARLY, max_size=8), st.integers(1, 64))
def test_no_bytes_make_the_connection_raise(lines: list[bytes], cut: int) -> None:
    stream = b"\n".join(lines) + b"\n"
    connection = Connection(max_line=4096)
    for start in range(0, len(stream), cut):
        for item in connection.receive(stream[start : start + cut]):
            if isinstance(item, RpcRequest):
                assert isinstance(item.params, METHODS[item.method].params)
            elif item.line is not None:
                answer = json.loads(item.line)
                assert answer["jsonrpc"] == "2.0"
                assert answer["error"]["data"]["kind"] in KINDS


@settings(deadline=None, derandomize=True, max_examples=50)
@given(JSON)
def test_any_parameters_are_taken_or_refused_with_a_kind(params: object) -> None:
    for method in METHODS:
        message = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        item = parse_line(json.dumps(message).encode())
        if isinstance(item, RpcFault):
            assert item.error.kind in ("request", "protocol")


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.text(max_size=64))
def test_a_sound_line_survives_the_way_in_and_out(text: str) -> None:
    item = parse_line(line("capture.wait", {"job": text}, id=text))
    assert isinstance(item, RpcRequest) and isinstance(item.params, JobParams)
    assert item.params.job == text
    assert json.loads(encode_reply(text, {"job": text})) == {
        "jsonrpc": "2.0",
        "id": text,
        "result": {"job": text},
    }


def test_every_kind_of_error_has_its_own_code() -> None:
    assert set(CODES) == set(KINDS)
    own = {kind: code for kind, code in CODES.items() if kind != "request"}
    assert len(set(own.values())) == len(own)
    assert CODES["request"] == CODES["config"]  # "invalid params", whoever wrote them
    error = BusyError("taken", device="display", hint="wait")
    assert json.loads(encode_error(4, error)) == {
        "jsonrpc": "2.0",
        "id": 4,
        "error": {
            "code": CODES["busy"],
            "message": "taken",
            "data": {"kind": "busy", "device": "display", "hint": "wait"},
        },
    }


def test_an_answer_longer_than_a_line_is_refused() -> None:
    with pytest.raises(ProtocolError):
        encode_reply(1, "x" * messages.MAX_LINE)


def test_no_nan_ever_leaves() -> None:
    text = encode_notification("event", {"rms_error_quads": float("nan"), "p": float("inf")})
    assert json.loads(text, parse_constant=lambda _: pytest.fail("not JSON"))["params"] == {
        "rms_error_quads": None,
        "p": None,
    }


def test_numbers_of_numpy_become_plain_and_objects_do_not_pass() -> None:
    np = pytest.importorskip("numpy")
    made = messages.to_wire_types({"a": np.int64(3), "b": np.float64(0.5), "c": "x"})
    assert made == {"a": 3, "b": 0.5, "c": "x"}
    assert type(made["a"]) is int and type(made["b"]) is float
    with pytest.raises(TypeError):
        messages.to_wire_types({"a": object()})


def test_the_schema_covers_every_method_and_refers_to_what_is_there() -> None:
    schema = json.loads(encode_reply(1, messages.build_message_schema()))["result"]
    assert set(schema["methods"]) == set(METHODS)
    text = json.dumps(schema)
    references = {part.split('"')[0] for part in text.split('"#/$defs/')[1:]}
    assert references
    assert references <= set(schema["$defs"])
    goal = schema["$defs"]["StartParams"]["properties"]["goal"]
    assert set(goal["enum"]) == set(get_args(GoalName))
    assert schema["$defs"]["StartParams"]["additionalProperties"] is False


def test_the_fields_of_an_error_are_those_of_a_result() -> None:
    assert to_error_fields(PdcdError("m", hint="h")) == {
        "kind": "internal",
        "message": "m",
        "device": None,
        "hint": "h",
    }
