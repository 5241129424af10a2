"""Stand-ins for the daemon and the rig, and what they answer: shared by the tests of the CLI."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd import words
from pdcd.bench.tables import Config
from pdcd.errors import PdcdError
from pdcd.protocol.events import Emit, Event, ShotArmed, decode_event
from pdcd.protocol.line_talk import EventHandler, UnreachableError
from pdcd.protocol.messages import ClockAnchor, JobView, Status
from pdcd.protocol.plan_summary import PlanSummary, ShotSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, SummaryValue
from pdcd.protocol.views import OwnerView
from pdcd.recipes.arrays import Given

JOB = "20260101T120301Z-7f3a"
SUMMARY: dict[str, SummaryValue] = {
    "codes": 8,
    "refreshes": 480,
    "exposure_s": 8.2,
    "missed_refreshes": 2,
    "rms_error_quads": 0.01234,
    "wall_s": 0.5,
}
DONE = CaptureResult(job=JOB, state="done", folder="/runs/x", summary=SUMMARY)
PLAN = PlanSummary(
    goal="indirect",
    family="hadamard",
    codes=8,
    p=0.5,
    grid=(48, 64),
    window="whole",
    guards=True,
    schedule="full",
    passes=2,
    shots=(ShotSummary(name="coded", codes=8, refreshes=24, exposure_s=0.5, light_share=0.25),),
    refreshes=24,
    seconds=0.5,
    light_share=0.25,
    raw_files=1,
)
WIRE: list[dict[str, Any]] = [
    {"job": JOB, "seq": 0, "type": "armed", "t_mono_ns": 1, "shot": "coded", "frames": 24},
    {"job": JOB, "seq": 1, "type": "progress", "t_mono_ns": 2, "shot": "coded", "frame": 12,
     "frames": 24, "missed": 0},
    {"job": JOB, "seq": 2, "type": "progress", "t_mono_ns": 3, "shot": "coded", "frame": 24,
     "frames": 24, "missed": 3},
    {"job": JOB, "seq": 3, "type": "of the future", "t_mono_ns": 4, "shot": "coded"},
    {"job": JOB, "seq": 4, "type": "decoding", "t_mono_ns": 5, "shots": 1},
]  # fmt: skip
EVENTS = [decode_event(fields) for fields in WIRE]
JOB_VIEW = JobView(
    job=JOB,
    state="running",
    goal="indirect",
    owner=OwnerView(uid=5, pid=6, user="ada"),
    detach=False,
    created_utc="2026-01-01T12:03:01Z",
)
STATUS = Status(
    version="9.9",
    state="busy",
    running=JOB_VIEW,
    queued=[],
    connections=2,
    uptime_s=61.4,
    clock=ClockAnchor(1, "2026-01-01T12:03:01Z"),
)


def ended(state: words.JobState, kind: str) -> CaptureResult:
    error: dict[str, str | None] = {
        "kind": kind,
        "message": "it broke",
        "device": "camera",
        "hint": "mend it",
    }
    return CaptureResult(job=JOB, state=state, error=error)


class StubClient:
    """Stands in for a daemon: answers from class attributes, records what was asked."""

    result: CaptureResult = DONE
    error: BaseException | None = None
    absent = False
    drawn_out = False
    """Whether devices take long to be made safe."""
    config = Config()
    status_answer: Status = STATUS
    asked: list[Any]

    def __init__(self, path: Path) -> None:
        if self.absent:
            raise UnreachableError("nobody")
        self.asked.append(path)

    def __enter__(self) -> StubClient:
        return self

    def __exit__(self, *unused: object) -> None:
        self.asked.append("closed")

    def _answer(self, *asked: Any) -> CaptureResult:
        self.asked.append(asked)
        if self.error is not None:
            raise self.error
        return self.result

    def capture(
        self,
        wanted: CaptureRequest,
        *,
        arrays: Mapping[str, Path],
        detach: bool,
        queue: bool,
        on_event: EventHandler,
    ) -> CaptureResult:
        for event in EVENTS:
            on_event(event)
        return self._answer(wanted, detach, queue, *[dict(arrays)] * bool(arrays))

    def wait(self, job: str, on_event: EventHandler = lambda _: None) -> CaptureResult:
        for event in EVENTS:
            on_event(event)
        return self._answer(job)

    def cancel(self, job: str) -> CaptureResult:
        result = self._answer("cancel", job)
        if self.drawn_out:
            return CaptureResult(job=job, state="running", warnings=("a device takes long",))
        return result

    def plan(
        self, wanted: CaptureRequest, *, arrays: Mapping[str, Path], queue: bool = False
    ) -> PlanSummary:
        self._answer("plan", wanted, *[dict(arrays)] * bool(arrays))
        return PLAN

    def call(self, method: str) -> Any:
        assert method == "config.get"
        return json.loads(msgspec.json.encode(self.config))

    def close(self) -> None:
        self.asked.append("closed")

    def status(self) -> Status:
        return self.status_answer

    def events(self) -> Iterator[Event]:
        return iter(EVENTS)


class StubEngine:
    """Stands in for the rig: one capture, scripted by `run`."""

    run: Callable[[Callable[[], bool]], CaptureResult]
    start_error: PdcdError | None = None
    calls: list[Any]
    grid = (2, 3)
    note = ""

    @classmethod
    def from_config(cls, config: Config) -> StubEngine:
        cls.calls.append(("from_config", config))
        return cls()

    with_child = from_config

    def start(self) -> None:
        self.calls.append("start")
        if self.start_error is not None:
            raise self.start_error

    def stop(self) -> None:
        self.calls.append("stop")

    def plan(self, wanted: CaptureRequest, given: Given) -> PlanSummary:
        self.calls.append(("plan", wanted, *given.values()))
        return PLAN

    def capture(
        self,
        wanted: CaptureRequest,
        given: Given,
        *,
        job: str,
        owner: OwnerView,
        emit: Emit,
        cancelled: Callable[[], bool],
        report: bool = False,
    ) -> CaptureResult:
        self.calls.append(("capture", wanted, job, owner, *given.values()))
        emit(ShotArmed(shot="coded", frames=24))
        return type(self).run(cancelled)


def last_object(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text.splitlines()[-1])
    return found


def home_at(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """The user's home is `folder`; the daemon's socket is looked for there, too."""
    monkeypatch.setenv("HOME", str(folder))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


def stub_daemon(monkeypatch: pytest.MonkeyPatch) -> type[StubClient]:
    """Let every command meet a fresh stub instead of a daemon."""

    class Fresh(StubClient):
        asked: list[Any] = []  # noqa: RUF012

    monkeypatch.setattr("pdcd.cli.daemon.Client", Fresh)
    return Fresh


def stub_engine(monkeypatch: pytest.MonkeyPatch) -> type[StubEngine]:
    """Let every command meet a fresh stub instead of a rig."""

    class Fresh(StubEngine):
        calls: list[Any] = []  # noqa: RUF012
        run = staticmethod(lambda cancelled: DONE)

    monkeypatch.setattr("pdcd.capture.engine.Engine", Fresh)
    return Fresh
