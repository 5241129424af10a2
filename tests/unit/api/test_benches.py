"""Benches from Python, whatever is behind them: what is passed on, and what comes back."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.api import bench as bench_module
from pdcd.api import connected as connected_module
from pdcd.api.bench import Bench
from pdcd.api.connected import DaemonBench, connect
from pdcd.api.local import LocalBench, local
from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.errors import DeniedError, RequestError
from pdcd.protocol.events import Event, JobStarted
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.views import RigView

WHITE = CaptureRequest(goal="white")
DONE = CaptureResult(job="j", state="done", folder="/x/j")


class Noted(Bench):
    """Notes what it is asked for."""

    def __init__(self) -> None:
        self.asked: list[Any] = []

    @property
    def grid(self) -> tuple[int, int]:
        return 2, 3

    def described(self) -> dict[str, Any]:
        return {"a": 1}

    def close(self) -> None:
        self.asked.append("close")

    def foresee(self, request: CaptureRequest, arrays: Any = None) -> Any:
        self.asked.append(("foresee", request, dict(arrays)))
        return "plan"

    def take(self, request: CaptureRequest, arrays: Any = None, **more: Any) -> CaptureResult:
        self.asked.append(("take", request, dict(arrays), more))
        return DONE


def test_keywords_become_a_request_and_what_comes_back_a_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bench_module, "open_run", lambda folder: f"run of {folder}")
    kernel = np.ones((1, 1))
    heard: list[Event] = []
    with Noted() as bench:
        assert bench.plan("filtered", kernel=kernel) == "plan"  # type: ignore[comparison-overlap]
        run: Any = bench.capture("white", progress=heard.append, codes=4)
        assert run == "run of /x/j"
        bench.capture("white", progress=False)
    plan, first, second, last = bench.asked
    assert plan[:2] == ("foresee", CaptureRequest(goal="filtered")) and plan[2]["kernel"] is kernel
    assert first[:3] == ("take", CaptureRequest(goal="white", codes=4), {})
    assert first[3] == {"on_event": heard.append, "report": True}
    assert second[3] == {"on_event": None, "report": True} and last == "close"
    with pytest.raises(RequestError, match="no such keyword"):
        bench.plan("white", code=4)  # type: ignore[call-arg]


# Behind a socket.


class Daemon:
    """What a client of it would say."""

    def __init__(self, *told: Any) -> None:
        self.told = told
        self.asked: list[Any] = []
        self.interrupted = False
        self.interrupt = False
        self.denies = False
        self.rise_s = 0.001

    def describe(self) -> RigView:
        self.asked.append("describe")
        return RigView(name="r", mock=True, grid=(3, 4), drivers={})

    def call(self, method: str) -> dict[str, Any]:
        assert method == "config.get"
        if self.denies:
            raise DeniedError("who looks on reads no configuration")
        return {"mask": {"rise_s": self.rise_s}, "server": {"socket": f"/{id(self)}"}}

    def plan(self, request: Any, **more: Any) -> str:
        self.asked.append((request, more))
        return "plan"

    def capture(self, request: Any, **more: Any) -> CaptureResult:
        self.asked.append((request, more))
        if self.interrupt:
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                self.interrupted = True
        return DONE

    def close(self) -> None:
        self.asked.append("close")


def behind(daemon: Daemon, **more: bool) -> DaemonBench:
    client: Any = daemon
    return DaemonBench(client, **more)


def test_the_bench_of_a_daemon_is_asked_for_its_grid_once_and_parted_from() -> None:
    daemon = Daemon()
    with behind(daemon) as bench:
        assert [bench.grid, bench.grid] == [(3, 4), (3, 4)]
        rig = msgspec.to_builtins(daemon.describe())
        assert bench.described() == {**rig, "config": {"mask": {"rise_s": 0.001}}}
        daemon.denies = True
        assert bench.described() == {**rig, "config": None}
    assert daemon.asked == ["describe"] * 4 + ["close"]


def test_a_daemon_is_where_it_is_told_or_where_the_configuration_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connected_module, "Client", Daemon)
    monkeypatch.setattr(connected_module, "load_config", lambda: "configuration")
    monkeypatch.setattr(connected_module, "find_socket_path", lambda config: Path(f"/of/{config}"))
    for socket, place in (
        (None, "/of/configuration"), ("/s", "/s"), (Path("/t"), "/t"),
    ):  # fmt: skip
        for queue in (False, True):
            bench = connect(socket, queue=queue)
            client: Any = bench.client
            assert client.told == (Path(place),)
            bench.foresee(WHITE)
            assert client.asked[0][1]["queue"] is queue
    assert not connect("/s")._queue


# In this process.


class Machine:
    """Stands for the engine."""

    grid = (2, 3)
    optics = "optics"

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.fails: Exception | None = None

    def start(self) -> None:
        self.asked.append("start")
        if self.fails is not None:
            raise self.fails

    def stop(self) -> None:
        self.asked.append("stop")

    def plan(self, request: Any, given: Any) -> str:
        self.asked.append((request, dict(given)))
        return "plan"

    def capture(self, request: Any, given: Any, **more: Any) -> CaptureResult:
        self.asked.append((request, dict(given), more))
        more["emit"](JobStarted(job="j", goal="white"))
        return DONE


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    made = Machine()
    monkeypatch.setattr(Engine, "from_config", lambda config: made)
    return made


def test_devices_are_opened_by_the_first_photo_and_let_go_of_once(machine: Machine) -> None:
    with local(Config()) as bench:
        optics: Any = bench.optics
        assert (bench.grid, optics) == ((2, 3), "optics")
        plan: Any = bench.foresee(WHITE)
        assert plan == "plan" and machine.asked == [(WHITE, {})]
        assert bench.take(WHITE) is DONE and bench.take(WHITE) is DONE
        bench.close()
    assert [word for word in machine.asked if isinstance(word, str)] == ["start", "stop"]
    assert bench.take(WHITE) is DONE  # it can be used again
    bench.close()
    assert machine.asked[-1] == "stop"
    LocalBench(Config()).close()
    assert machine.asked.count("stop") == 2


def test_a_photo_goes_to_the_folder_of_the_bench_unless_it_has_its_own(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    heard: list[Event] = []
    own = msgspec.structs.replace(WHITE, out="/elsewhere")
    for bench in (local(Config(), folder="runs"), local(Config(), folder=tmp_path / "runs")):
        bench.take(WHITE, on_event=heard.append, report=True)
        bench.take(own)
    local(Config()).take(WHITE)
    told = [entry for entry in machine.asked if isinstance(entry, tuple)]
    outs = [request.out for request, _, _ in told]
    assert outs == [str(tmp_path / "runs"), "/elsewhere"] * 2 + [None]
    assert [more["report"] for _, _, more in told] == [True, False, True, False, False]
    assert [event.type for event in heard] == ["started"] * 2
    assert len({more["job"] for _, _, more in told}) > 1
    for _, _, more in told:
        assert not more["cancelled"]() and more["owner"].pid > 0
