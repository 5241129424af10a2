"""Messages as values: what may be in them, what stands for what is left out, and their schema."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pdcd.errors import BusyError
from pdcd.protocol import events, messages
from pdcd.protocol.entry import MOST_RUNS, RunQuery
from pdcd.protocol.messages import METHODS, JobParams, ShowParams
from pdcd.protocol.views import ClientRole


def taken(kind: type[msgspec.Struct], **params: Any) -> Any:
    return msgspec.convert(params, kind)


@pytest.mark.parametrize("method", METHODS)
def test_parameters_refuse_what_is_misspelt(method: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        taken(METHODS[method].params, nonsense=1)


def test_a_calibration_is_passed_on_whole() -> None:
    kind = METHODS["calibrate.start"].params
    given = taken(kind, steps=["timing"], attended=True, queue=True, detach=True)
    request = given.request()
    assert (request.steps, request.attended) == (("timing",), True)
    assert not hasattr(request, "queue") and not hasattr(request, "detach")


@pytest.mark.parametrize(
    ("kind", "good", "wrong"),
    [
        (JobParams, {"job": "x" * 64}, {"job": "x" * 65}),
        (RunQuery, {"newest": MOST_RUNS}, {"newest": MOST_RUNS + 1}),
        (ShowParams, {"pattern": "code", "index": 0}, {"pattern": "code", "index": -1}),
        (
            ShowParams,
            {"pattern": "code", "index": 2**31 - 1},
            {"pattern": "code", "index": 2**31},
        ),
    ],
)
def test_numbers_and_names_have_their_bounds(
    kind: type[msgspec.Struct], good: dict[str, Any], wrong: dict[str, Any]
) -> None:
    made = taken(kind, **good)
    assert {name: getattr(made, name) for name in good} == good
    with pytest.raises(msgspec.ValidationError):
        taken(kind, **wrong)


def test_the_numbers_of_the_wire_are_those_that_were_agreed_on() -> None:
    assert messages.PROTOCOL == (1, 0)
    assert (messages.MAX_LINE, messages.MAX_FDS) == (1_048_576, 16)
    # JSON-RPC 2.0, section 5.1.
    assert messages.PARSE_ERROR == -32700 and messages.METHOD_NOT_FOUND == -32601
    assert dict(messages.CODES) == {
        "protocol": -32600, "config": -32602, "request": -32602, "internal": -32603,
        "busy": -32001, "cancelled": -32002, "device_lost": -32003, "driver_unavailable": -32004,
        "sync": -32005, "exposure": -32006, "decode": -32007, "no_space": -32008, "plan": -32009,
        "denied": -32010, "disk": -32011, "calibration": -32012,
    }  # fmt: skip


def test_an_error_has_the_code_of_its_kind_or_the_one_that_is_asked_for() -> None:
    error = BusyError("taken", device="display", hint="wait")
    for code, wanted in ((None, -32001), (-32700, -32700), (0, 0)):
        made = messages.make_error_object(error, code)
        assert (made.code, made.message) == (wanted, "taken")
        assert (made.data.kind, made.data.device, made.data.hint) == ("busy", "display", "wait")


def test_roles_rise_and_only_wishes_for_photos_take_descriptors() -> None:
    assert ClientRole.LOOK < ClientRole.SHOOT < ClientRole.ADMINISTER
    takers = {n for n, m in METHODS.items() if m.takes_fds}
    assert takers == {"capture.plan", "capture.start", "stream.start"}
    assert {m.role for m in METHODS.values()} == {ClientRole.LOOK, ClientRole.SHOOT}


def test_what_is_sent_of_an_event_has_all_fields() -> None:
    schema = messages.build_message_schema()
    for kind in events.TYPES.values():
        sent = schema["$defs"][kind.__name__]
        assert sorted(sent["required"]) == sorted(sent["properties"])
        for name in events.COMMON_FIELDS:
            assert "default" not in sent["properties"][name]
    assert [*schema["notifications"]] == ["hello", "event"]
    assert schema["notifications"]["hello"] == {"$ref": "#/$defs/Hello"}
    assert schema["error"] == {"$ref": "#/$defs/ErrorObject"}
    for name, method in METHODS.items():
        leaf = schema["methods"][name]
        assert leaf["params"] == {"$ref": f"#/$defs/{method.params.__name__}"}
        assert leaf["result"] == {"$ref": f"#/$defs/{method.result.__name__}"}


def test_only_numbers_of_others_are_made_plain() -> None:
    class Odd:
        """Neither."""

    with pytest.raises(TypeError, match="Odd cannot be sent as JSON"):
        messages.to_wire_types([Odd()])
