"""An engine without a rig: does what the request's note says, and can be run as a daemon.

Notes of captures and plans: "" a short run; "slow" runs until cancelled; "fail:KIND" fails with
that kind; "raise" raises what no engine should; of captures only: "freeze:SECONDS" blocks, deaf to
cancels; "flood:N" tells N times of progress.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, MutableSequence
from pathlib import Path

import msgspec
import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.tables import Config, RigConfig, ServerConfig
from pdcd.errors import Cancelled, DeviceLost, RequestError, make_error
from pdcd.protocol import events
from pdcd.protocol.events import Emit, Progress, ShotArmed, ShutterClosed, ShutterOpen
from pdcd.protocol.plan_summary import PlanSummary, ShotSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamedPicture, StreamFrame, StreamRequest
from pdcd.protocol.views import LiveFrame, OwnerView, PreviewView, RigView
from pdcd.recipes.arrays import Given
from pdcd.runs.place import HeldFolder
from pdcd.runs.recording import StreamListener
from pdcd.server.daemon import run_daemon
from pdcd.words import JobState


class FakeEngine:
    """Satisfies `EngineLike`; `calls` holds what was asked, `threads` by whom."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.calls: list[str] = []
        self.threads: set[int] = set()
        self.owners: list[OwnerView] = []
        self.requests: list[CaptureRequest] = []
        self.given: MutableSequence[dict[str, Floats]] = []
        self.shutter_open = False
        self.lit: str | None = None
        """The pattern that `show` left on the panels."""
        self.slow_previews = False

    def _until_cancelled(self, slow: bool, cancelled: Callable[[], bool]) -> None:
        while slow:
            if cancelled():
                raise Cancelled("cancelled")
            time.sleep(0.002)

    def _note(self, call: str) -> None:
        self.calls.append(call)
        self.threads.add(threading.get_ident())

    def start(self) -> None:
        self._note("start")
        if self.config.rig.name == "broken":
            raise DeviceLost("no such camera", device="camera", hint="switch it on")

    def stop(self) -> None:
        self._note("stop")

    deaf_s = 0.0

    def break_off(self) -> None:
        """Nothing here waits for a device."""

    def make_safe_beside(self, within_s: float) -> bool:
        self.shutter_open, self.lit = False, None
        return True

    def describe(self) -> RigView:
        self._note("describe")
        return RigView(name=self.config.rig.name, mock=False, grid=(4, 6), drivers={})

    def plan(
        self,
        request: CaptureRequest,
        given: Given,
        *,
        emit: Emit,
        cancelled: Callable[[], bool],
    ) -> PlanSummary:
        self._note("plan")
        self.given.append(dict(given))
        verb, _, value = request.note.partition(":")
        if verb == "raise":
            raise RuntimeError("a fault of the program")
        if verb == "fail":
            raise make_error(value, "it broke", "camera", "mend it")
        self._until_cancelled(verb == "slow", cancelled)
        codes = request.codes or 8
        shot = ShotSummary(
            name=request.goal, codes=codes, refreshes=8 * codes, exposure_s=1.0, light_share=0.25
        )
        return PlanSummary(
            goal=request.goal,
            family=request.family or "hadamard",
            codes=codes,
            p=0.0,
            grid=(4, 6),
            window="whole",
            guards=True,
            passes=1,
            shots=(shot,),
            refreshes=8 * codes,
            seconds=1.0,
            light_share=0.25,
            raw_files=1,
        )

    def capture(
        self,
        request: CaptureRequest,
        given: Given,
        *,
        job: str,
        owner: OwnerView,
        emit: Emit,
        cancelled: Callable[[], bool],
        parent: HeldFolder | None = None,
        report: bool = False,
    ) -> CaptureResult:
        self._note("capture")
        assert self.lit is None
        self.requests.append(request)
        self.given.append(dict(given))
        self.owners.append(owner)
        verb, _, value = request.note.partition(":")
        if verb == "raise":
            raise RuntimeError("a fault of the program")
        emit(ShotArmed(shot="s1", frames=20))
        self.shutter_open = True
        emit(ShutterOpen(shot="s1"))
        state: JobState = "done"
        error: dict[str, str | None] | None = None
        if verb == "freeze":
            time.sleep(float(value))
        elif verb == "fail":
            state = "failed"
            # What a note may not hold, another part of the program may still say.
            kind = value.encode().decode("unicode_escape")
            error = {"kind": kind, "message": "it broke", "device": "camera", "hint": "mend it"}
        frames = int(value) if verb == "flood" else 20
        frame = 0
        while state == "done" and (verb == "slow" or frame < frames):
            frame += 1
            emit(Progress(shot="s1", frame=frame, frames=max(frame, frames), missed=0))
            if cancelled():
                state = "cancelled"
                error = {"kind": "cancelled", "message": "cancelled", "device": None, "hint": None}
            if verb != "flood":
                time.sleep(0.002)
        self.shutter_open = False
        emit(ShutterClosed(shot="s1"))
        self._note("closed")
        return CaptureResult(
            job=job,
            state=state,
            folder=f"{request.out or '/nowhere'}/{job}",
            error=error,
            files=("raw/s1.dng",),
            summary={"codes": request.codes, "frames": frame},
        )

    def calibrate(
        self,
        request: CalibrateRequest,
        *,
        job: str,
        emit: Emit,
        cancelled: Callable[[], bool],
        proceed: Callable[[str], None],
    ) -> CaptureResult:
        self._note("calibrate")
        for step in request.steps:
            emit(events.StepBegun(step=step, number=1, steps=len(request.steps)))
            if request.attended:
                emit(events.Attention(text="put up the card"))
                proceed("put up the card")
                if cancelled():
                    return CaptureResult(job=job, state="cancelled")
            emit(
                events.StepEnded(
                    step=step, verdict="good", photos=0, seconds=0.0, figures=(), advice=()
                )
            )
        return CaptureResult(job=job, state="done")

    def show(self, pattern: str, index: int) -> None:
        self._note(f"show {pattern} {index}")
        if pattern == "code" and index > 99:
            raise RequestError(f"code {index} does not exist", hint="0 to 99")
        self.lit = None if pattern == "black" else pattern

    def live(
        self,
        pattern: str,
        index: int,
        *,
        job: str,
        tell: Callable[[LiveFrame], object],
        cancelled: Callable[[], bool],
        ended: Callable[[], bool],
    ) -> CaptureResult:
        self._note(f"live {pattern} {index}")
        self.lit, number = pattern, 0
        while not (over := ended()) and not cancelled():
            number += 1
            tell(
                LiveFrame(
                    number=number, t_mono_ns=time.monotonic_ns(), rate_hz=1.0, focus=0.5, best=0.5,
                    mean=0.25, saturated=0.0, size_px=(1, 1), jpeg=b"picture",
                )
            )  # fmt: skip
            time.sleep(0.002)
        self.lit = None
        return CaptureResult(job=job, state="done" if over else "cancelled")

    def stream(
        self,
        request: StreamRequest,
        given: Given,
        *,
        job: str,
        owner: OwnerView,
        emit: Emit,
        listener: StreamListener,
    ) -> CaptureResult:
        """Pictures of their own number; every tenth photo is spoilt, and its picture missing."""
        self._note(f"stream {request.goal}")
        number = 0
        while not listener.cancelled() and (request.for_s is None or number < 20):
            number += 1
            if (order := listener.next_record()) is not None:
                order.done(CaptureResult(job=order.job, state="done", folder="/nowhere"))
            bad = number % 10 == 0
            frame = StreamFrame(
                number=number, t_mono_ns=time.monotonic_ns(), goal=request.goal,
                spoilt="late" if bad else "", lost=number // 10,
                jpeg=b"picture" if listener.draws() and not bad else b"",
            )  # fmt: skip
            arrays = {"image": np.full((2, 3, 1), float(number)), "sigma": np.ones((2, 3, 1))}
            arrays |= {"picture": np.full((40, 60, 1), float(number), np.float32)}
            arrays |= {"picture_sigma": np.ones((40, 60, 1), np.float32)}
            listener.tell(StreamedPicture(frame, {} if bad else arrays))
            time.sleep(0.002)
        over = request.for_s is not None
        return CaptureResult(job=job, state="done" if over else "cancelled")

    def preview(
        self, *, job: str, owner: OwnerView, emit: Emit, cancelled: Callable[[], bool]
    ) -> PreviewView:
        self._note("preview")
        assert self.lit is None  # a picture on the panels would be in the photo
        self.shutter_open = True
        try:
            emit(ShutterOpen(shot="white"))
            self._until_cancelled(self.slow_previews, cancelled)
        finally:
            self.shutter_open = False
        return PreviewView(path="/nowhere/preview.png", sha256="0" * 64, shape=(4, 6, 3))


def main() -> int:
    """Serve this engine from a process of its own; tells of its end on stdout."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--socket", type=Path)
    parser.add_argument("--state-dir", required=True)
    parser.add_argument("--rig", default="fake")
    parser.add_argument("--shoot", type=int, nargs="*", default=())
    given = parser.parse_args()
    server = ServerConfig(state_dir=given.state_dir, allow_uids=tuple(given.shoot))
    config = Config(rig=RigConfig(name=given.rig), server=server)
    engines: list[FakeEngine] = []

    def make(config: Config) -> FakeEngine:
        engines.append(FakeEngine(config))
        engines[-1].given = deque(maxlen=1)  # its memory is measured
        return engines[-1]

    code = run_daemon(config, socket=given.socket, engine_factory=make)
    told = [{"calls": e.calls, "shutter_open": e.shutter_open, "lit": e.lit} for e in engines]
    sys.stdout.write(msgspec.json.encode(told).decode() + "\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
