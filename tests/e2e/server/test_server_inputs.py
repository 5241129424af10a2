"""What is wrong on the socket is answered with a kind and a hint, and hurts nobody else."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.protocol.messages import MAX_LINE
from tests.e2e.server._server_harness import Daemon, Wire, served


@served
async def test_the_server_speaks_first(wire: Wire) -> None:
    assert wire.hello["method"] == "hello" and "id" not in wire.hello
    said = wire.hello["params"]
    assert said["server"] == "pdcd" and said["protocol"] == [1, 0]
    assert said["max_line"] == 2**20 and said["state"] == "idle"
    assert said["drivers"] == {"display": "mock", "shutter": "mock", "readout": "mock"}
    assert said["clock"]["mono_ns"] > 0 and said["clock"]["utc"].endswith("+00:00")
    assert await wire.result("hello", protocol=[1, 0]) == {"protocol": [1, 0]}


@served
async def test_bad_lines_are_answered_and_the_connection_goes_on(wire: Wire) -> None:
    bad = [
        b"nonsense",
        b"\xff\xfe",
        b'[{"jsonrpc":"2.0","id":1,"method":"ping"}]',
        b'{"jsonrpc":"2.0","id":1,"method":"capture.start","params":{"exposure_s":NaN}}',
        b"[" * 100_000,
    ]

    for line in bad:
        await wire.send(line)
        error = (await wire.answer(None))["error"]
        assert error["data"]["kind"] == "protocol", line
        assert error["data"]["hint"], line
    await wire.result("ping")


@pytest.mark.parametrize(
    ("method", "params", "kind"),
    [
        ("nonsense", {}, "protocol"),
        ("calibrate.start", {"steps": ["lihgt"]}, "request"),
        ("capture.start", {"goal": "sideways"}, "request"),
        ("capture.wait", {"job": "20260101T000000Z-0000"}, "request"),
        ("capture.cancel", {"job": "20260101T000000Z-0000"}, "request"),
    ],
)
@served
async def test_a_bad_request_starts_nothing(
    running: Daemon, wire: Wire, method: str, params: dict[str, object], kind: str
) -> None:
    error = await wire.error(method, **params)
    assert error["data"]["kind"] == kind and error["data"]["hint"]
    assert (await wire.result("capture.list"))["jobs"] == []
    assert "capture" not in running.engine.calls


@served
async def test_an_over_long_line_is_refused_and_ends_the_connection(
    other: Wire, wire: Wire
) -> None:
    wire.writer.write(b"x" * (MAX_LINE + 1))
    error = (await wire.answer(None))["error"]
    assert error["data"]["kind"] == "protocol" and error["code"] == -32700
    assert await wire.ended()
    await other.result("ping")


@served
async def test_results_stay_below_the_state_folder(
    running: Daemon, wire: Wire, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    outside = tmp_path / "outside"
    outside.mkdir()
    (state / "way-out").symlink_to(outside)
    (state / "inside").mkdir()
    (state / "way-in").symlink_to(state / "inside")
    (state / "run").mkdir()
    (state / "run" / "capture.json").touch()
    (state / "run" / "raw").mkdir()
    (state / "x.partial").mkdir()
    (state / "file").touch()
    (state / "loop").symlink_to("loop")
    wrong = ("/etc", str(outside), "..", "a/../../b", "way-out", "way-out/x", "way-in",
             "\0", "loop", "x" * 300, "a/" * 3000, "file", "file/x", "a\nb", "run",
             "run/raw", "run/raw/new", "run/new", "x.partial", "x.partial/new",
             "new.partial", "new/20261122T030042Z-cadb/x",
             str(state / "run" / "raw"), f"{state}x")  # fmt: skip
    before = sorted(tmp_path.rglob("*"))
    for out in wrong:
        for method in ("capture.start", "capture.plan"):
            error = await wire.error(method, goal="white", out=out)
            assert error["data"]["kind"] == "request" and error["code"] == -32602, out
            assert error["data"]["hint"], out
    assert sorted(tmp_path.rglob("*")) == before
    assert "capture" not in running.engine.calls
    await wire.result("capture.plan", goal="white", out="new/one")
    assert sorted(tmp_path.rglob("*")) == before, "a plan makes nothing"
    good = {"new/one": "new/one", "inside": "inside", ".": "", str(state / "two"): "two"}
    for out, meant in good.items():
        started = await wire.result("capture.start", goal="white", out=out)
        await wire.result("capture.wait", job=started["job"])
        assert running.engine.requests[-1].out == str((state / meant).resolve())


@served
async def test_notifications_are_done_but_not_answered(running: Daemon, wire: Wire) -> None:
    await wire.send(b'{"jsonrpc":"2.0","method":"nonsense"}')
    await wire.send(b'{"jsonrpc":"2.0","method":"display.show","params":{"pattern":"white"}}')
    await wire.send(b'{"jsonrpc":"2.0","id":"after","method":"capture.plan",')
    assert (await wire.receive())["id"] is None
    assert (await wire.ask("capture.plan", goal="white"))["id"] == 1
    assert "show white 0" in running.engine.calls


@served
async def test_a_burst_of_requests_is_answered_in_order(wire: Wire) -> None:
    lines = [b'{"jsonrpc":"2.0","id":%d,"method":"ping"}\n' % k for k in range(3000)]
    wire.writer.write(b"".join(lines))
    assert [(await wire.receive())["id"] for _ in lines] == list(range(3000))


@served
async def test_the_goals_and_their_parameters_are_told(wire: Wire) -> None:
    told = await wire.result("rig.describe")
    fields = told["schema"]["$defs"]["StartParams"]["properties"]
    assert set(told["goals"]) == set(fields["goal"]["enum"])
    assert told["goals"]["off-diagonal"]["needs"] == ["shift"]
    assert told["goals"]["off-diagonal"]["may"] == ["p", "illumination"]
    assert told["goals"]["illuminated"]["may"] == []
    named = {name for goal in told["goals"].values() for name in goal["needs"] + goal["may"]}
    assert named <= set(fields) and set(told["arrays"]) <= named
