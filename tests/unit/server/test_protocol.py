"""The codec: what is answered to which bytes, and that no bytes make it raise."""

from __future__ import annotations

import json
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdcd.errors import KINDS, BusyError, ProtocolError
from pdcd.protocol import messages
from pdcd.protocol.messages import CODES, MAX_LINE, METHODS, JobParams, StartParams
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


def line(method: str = "ping", params: Any = None, **envelope: Any) -> bytes:
    """A request line, without its newline."""
    message = {"jsonrpc": "2.0", "id": 1, "method": method, **envelope}
    return json.dumps(message if params is None else {**message, "params": params}).encode()


def fault(data: bytes) -> dict[str, Any]:
    """The answer to a line that is refused, read by another JSON reader."""
    item = parse_line(data)
    assert isinstance(item, RpcFault) and item.line is not None and not item.close
    assert item.line.endswith(b"\n") and item.line.count(b"\n") == 1
    answer: dict[str, Any] = json.loads(item.line)
    assert answer["jsonrpc"] == "2.0" and answer["error"]["data"]["hint"]
    return answer


# --- what is meant ------------------------------------------------------------------------------

EVERY_FIELD = {
    "goal": "fraction", "codes": 5, "family": "balanced", "p": 0.5, "shift": (1, -2), "radius": 2,
    "mix": (0.5, -1.0), "period": 8, "disparity": (-1, 2), "keep": "out", "rows": (3, 4),
    "plane": (1.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), "masked": True,
    "equal_brightness": True, "illumination": "light.npy", "warp": "warp.npy",
    "warp_b": ((1.0, 0.0),), "region_a": "a.png", "region_b": "b.png",
    "disparities": "disparities.npy", "kernel": ((1.0,),), "matrix": "matrix.npy",
    "method": "nayar", "pilot": 4, "smooth": True, "grey_masks": False, "parts": 2,
    "until_error": 0.01, "repeat": 3, "error": 0.02, "confidence": 0.9, "seconds": 30.0,
    "prior": "prior.npz", "codes_from": "codes.npz", "seed": 9, "exposure_s": 2.5,
    "window": "quarter", "guards": False,
    "black_level": "both", "normalise": "row", "white": False, "white_patch": (0.25, 1.0),
    "keep_raw": "last", "out": "here", "name": "a chart", "tags": ("glass",), "note": "n",
}  # fmt: skip


def test_a_request_becomes_its_typed_parameters_with_every_field() -> None:
    assert set(EVERY_FIELD) == set(CaptureRequest.__struct_fields__)
    item = parse_line(line("capture.start", {**EVERY_FIELD, "queue": True}, id="a"))
    assert isinstance(item, RpcRequest) and (item.id, item.method) == ("a", "capture.start")
    assert isinstance(item.params, StartParams) and item.params.queue and not item.params.detach
    made = item.params.request()
    assert {name: getattr(made, name) for name in EVERY_FIELD} == EVERY_FIELD


def test_a_notification_has_no_id_and_its_fault_no_answer() -> None:
    item = parse_line(b'{"jsonrpc":"2.0","method":"ping"}')
    assert isinstance(item, RpcRequest) and item.id is None
    item = parse_line(b'{"jsonrpc":"2.0","method":"nonsense"}')
    assert isinstance(item, RpcFault) and item.line is None


@pytest.mark.parametrize("good", [0, -1, 2**53 - 1, 1 - 2**53, "", "x" * 128])
def test_ids_that_every_client_can_hold_are_echoed(good: str | int) -> None:
    item = parse_line(line(id=good))
    assert isinstance(item, RpcRequest) and item.id == good
    assert fault(line("nonsense", id=good))["id"] == good


# --- what is not --------------------------------------------------------------------------------

FAULTS: list[tuple[bytes, int, int | str | None]] = [
    # No JSON.
    (b"{", -32700, None),
    (b"nonsense", -32700, None),
    (line() + b" trailing", -32700, None),
    *[(line("capture.start", {"exposure_s": 7}).replace(b"7", wrong), -32700, None)
      for wrong in (b"NaN", b"Infinity")],
    (b'{"jsonrpc":"2.0","id":1,"method":"\xff"}', -32700, None),
    (b'{"jsonrpc":"2.0","id":1,"method":"\\ud800"}', -32700, None),
    (b"[" * 200_000, -32700, None),
    (b"[" * 200_000 + b"]" * 200_000, -32700, None),
    # No request; its id as far as it is sound.
    (b"[" + line() + b"]", -32600, None),
    (b"1", -32600, None),
    (b"9" * 5000, -32600, None),
    (b"null", -32600, None),
    (b"{}", -32600, None),
    (b'{"jsonrpc":"2.0","id":7}', -32600, 7),
    (line(jsonrpc="1.0", id=7), -32600, 7),
    (b'{"id":7,"method":"ping"}', -32600, 7),
    (b'{"jsonrpc":"2.0","id":"x","method":5}', -32600, "x"),
    (b'{"jsonrpc":"2.0","id":3,"result":{}}', -32600, 3),
    *[(line(id=wrong), -32600, None)
      for wrong in (2**53, -(2**53), "x" * 129, 1.5, None, [1], True)],
    (line(fds=17), -32600, 1),
    # Not what the method takes.
    (line("capture.erase", id=6), -32601, 6),
    (line("capture.wait", {}, id=7), -32602, 7),
    *[(line("capture.start", id=8, params=wrong), -32602, 8) for wrong in ([], ["white"], "x", 3)],
    (line("capture.start"), -32602, 1),
    (line("capture.start", {"exposure_s": 7}).replace(b"7", b"1e999"), -32602, 1),
    (line("capture.start", {"note": "7"}).replace(b"7", b"\xff"), -32700, None),
]  # fmt: skip


@pytest.mark.parametrize(("data", "code", "request_id"), FAULTS)
def test_each_fault_has_its_code_and_id(
    data: bytes, code: int, request_id: int | str | None
) -> None:
    answer = fault(data)
    assert (answer["error"]["code"], answer["id"]) == (code, request_id)
    assert answer["error"]["data"]["kind"] == ("request" if code == -32602 else "protocol")


@pytest.mark.parametrize(
    ("method", "params", "named"),
    [
        ("capture.start", {}, "goal"),
        *[
            ("capture.start", {"goal": "white", **wrong}, next(iter(wrong)))
            for wrong in (
                {"goal": "sideways"}, {"family": "random"}, {"codes": 0}, {"codes": 65537},
                {"codes": "8"}, {"codes": 8.0}, {"codes": True}, {"seed": -1}, {"seed": 2**53},
                {"seed": 10**30}, {"p": 1}, {"exposure_s": 0}, {"code": 8}, {"detach": 1},
                {"note": "x" * 4097},
            )
        ],
        ("capture.plan", {"goal": "white", "detach": True}, "detach"),
        ("capture.wait", {"job": 7}, "job"),
        ("capture.cancel", {"job": "x" * 65}, "job"),
        ("display.show", {"pattern": "stripes"}, "pattern"),
        ("display.show", {"pattern": "code", "index": -1}, "index"),
        ("events.subscribe", {"jobs": "some"}, "jobs"),
        ("ping", {"loud": True}, "loud"),
        ("hello", {"protocol": [1]}, "protocol"),
    ],
)  # fmt: skip
def test_a_wrong_parameter_is_named(method: str, params: dict[str, Any], named: str) -> None:
    error = fault(line(method, params))["error"]
    assert (error["code"], error["data"]["kind"]) == (-32602, "request")
    assert f" {named}: it takes" in error["message"] or f"`{named}`" in error["message"]


def test_faults_say_what_there_is() -> None:
    error = fault(line("capture.start", {"goal": "sideways"}))["error"]
    assert all(goal in error["message"] for goal in get_args(GoalName))
    error = fault(line("display.show", {"pattern": "code", "index": -1}))["error"]
    assert error["message"] == (
        "display.show: index: it takes a whole number from 0 to 2147483647, not -1"
    )
    error = fault(line("display.show", {"pattern": "code", "more": 1}))["error"]
    assert error["data"]["hint"].startswith("fields are: pattern, index, detach;")
    error = fault(line("capture.erase"))["error"]
    assert "capture.start" in error["data"]["hint"]


def test_what_faults_are_told_by_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Schemas and decoders cost milliseconds, on the thread that answers everybody."""
    wrong = [("capture.start", {"codes": 0}), ("display.show", {"pattern": "code", "index": -1})]
    said = [fault(line(*one)) for one in wrong]

    def made(*_: Any, **__: Any) -> None:
        raise AssertionError("made once more")

    for name in ("json.Decoder", "json.schema", "json.schema_components", "inspect.type_info",
                 "defstruct", "structs.fields"):  # fmt: skip
        monkeypatch.setattr(f"msgspec.{name}", made)
    assert [fault(line(*one)) for one in wrong] == said


# --- streams ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wanted", "agreed"), [([1, 0], True), ([1, 1], False), ([0, 9], False), ([2, 0], False)]
)
def test_hello_closes_on_a_version_that_is_not_spoken(wanted: list[int], agreed: bool) -> None:
    connection = Connection()
    (item,) = connection.receive(line("hello", {"protocol": wanted}) + b"\n")
    assert isinstance(item, RpcRequest) is agreed
    assert connection.closed is not agreed
    assert len([*connection.receive(line("ping") + b"\n")]) == (1 if agreed else 0)


def test_lines_are_found_whatever_the_cut() -> None:
    stream = b"".join(line(id=k) + ending for k, ending in enumerate([b"\n", b"\r\n"] * 3))
    whole = [*Connection().receive(b"\n \t \r\n" + stream + line(id=6))]
    assert [item.id for item in whole if isinstance(item, RpcRequest)] == [0, 1, 2, 3, 4, 5]
    connection = Connection()
    single = [item for k in range(len(stream)) for item in connection.receive(stream[k : k + 1])]
    assert single == whole


def test_a_line_of_exactly_the_limit_passes_and_one_byte_more_ends_the_connection() -> None:
    limit = len(line()) + 1
    assert len([*Connection(max_line=limit).receive((line() + b"\n") * 2)]) == 2
    for begins in (line() + b" \n", b" " * limit):
        connection = Connection(max_line=limit)
        (over,) = connection.receive(begins)
        assert isinstance(over, RpcFault) and over.close and over.line is not None
        assert json.loads(over.line)["error"]["code"] == -32700 and connection.closed
        assert [*connection.receive(b"\n" + line() + b"\n")] == []
    blank = Connection(max_line=limit)
    assert [*blank.receive(b" " * (limit - 1)), *blank.receive(b"\n")] == [] and not blank.closed


def test_an_endless_line_is_refused_before_it_fills_the_memory() -> None:
    connection = Connection()
    found: list[RpcRequest | RpcFault] = []
    for _ in range(64):
        found += connection.receive(b"x" * 65536)
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


@settings(max_examples=20)
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


@settings(max_examples=50)
@given(JSON, st.text(max_size=64))
def test_any_parameters_are_taken_or_refused_with_a_kind(params: object, text: str) -> None:
    for method in METHODS:
        item = parse_line(line(method, params))
        if isinstance(item, RpcFault):
            assert item.error.kind in ("request", "protocol")
    item = parse_line(line("capture.wait", {"job": text}, id=text))
    assert isinstance(item, RpcRequest) and isinstance(item.params, JobParams)
    assert item.params.job == text
    wanted = {"jsonrpc": "2.0", "id": text, "result": {"job": text}}
    assert json.loads(encode_reply(text, {"job": text})) == wanted


# --- the way out --------------------------------------------------------------------------------


def test_every_kind_of_error_has_its_own_code() -> None:
    assert set(CODES) == set(KINDS)
    own = {kind: code for kind, code in CODES.items() if kind != "request"}
    assert len(set(own.values())) == len(own)
    assert CODES["request"] == CODES["config"]  # "invalid params", whoever wrote them
    data = {"kind": "busy", "device": "display", "hint": "wait"}
    wanted = {"code": CODES["busy"], "message": "taken", "data": data}
    error = BusyError("taken", device="display", hint="wait")
    assert json.loads(encode_error(4, error)) == {"jsonrpc": "2.0", "id": 4, "error": wanted}
    assert json.loads(encode_error(None, error, 7))["error"] == {**wanted, "code": 7}


def test_a_line_out_may_be_as_long_as_one_in() -> None:
    bare = len(encode_reply(1, ""))
    assert len(encode_reply(1, "x" * (MAX_LINE - bare))) == MAX_LINE
    with pytest.raises(ProtocolError, match=f"the answer is {MAX_LINE + 1} bytes") as caught:
        encode_reply(1, "x" * (MAX_LINE - bare + 1))
    assert caught.value.hint == "read it from the run folder instead"


def test_no_nan_ever_leaves() -> None:
    text = encode_notification("event", {"rms_error_quads": float("nan"), "p": float("inf")})
    told = json.loads(text, parse_constant=lambda _: pytest.fail("not JSON"))
    assert told["method"] == "event" and "id" not in told
    assert told["params"] == {"rms_error_quads": None, "p": None}


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
    references = {part.split('"')[0] for part in json.dumps(schema).split('"#/$defs/')[1:]}
    assert references and references <= set(schema["$defs"])
    start = schema["$defs"]["StartParams"]
    assert set(start["properties"]["goal"]["enum"]) == set(get_args(GoalName))
    assert start["additionalProperties"] is False
