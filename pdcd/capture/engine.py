"""Runs a plan on a rig: arm, open, play, close, fetch, decode, archive. On errors it leaves the rig
safe."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from pdcd.bench.calibration import read_calibration
from pdcd.bench.choosing import CALIBRATIONS_FOLDER, find_other_device, lock_calibration_in_use
from pdcd.bench.folders import find_state_dir
from pdcd.bench.measured import CalibrationChoice, choose_calibration, link_calibration
from pdcd.bench.tables import Config, SceneConfig
from pdcd.capture.job import (
    EngineJob,
    describe_rig,
    make_failure,
    make_planning_watch,
    mark_kept,
    mark_unsafe,
    mark_used,
    to_job_error,
)
from pdcd.capture.rig import Rig
from pdcd.capture.run import CaptureRun
from pdcd.capture.worker.answers import RigFacts
from pdcd.capture.worker.proxy import InProcessWorker, WorkerProxy
from pdcd.capture.worker.worker import Worker
from pdcd.errors import Cancelled, DeviceLost
from pdcd.panels.frames import Frames
from pdcd.planning.bench_fit import with_grid
from pdcd.planning.defaults import is_camera_needed, is_search_needed
from pdcd.planning.schedule_fit import is_lag_needed
from pdcd.protocol.events import Emit, Event
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamRequest
from pdcd.protocol.views import LiveFrame, OwnerView, PreviewView, RigView
from pdcd.recipes.arrays import NO_ARRAYS, Given
from pdcd.runs.folder import RunFolder
from pdcd.runs.place import HeldFolder
from pdcd.runs.recording import StreamListener
from pdcd.sensor.profile import load_profile
from pdcd.virtual.scene.build import CARD

if TYPE_CHECKING:
    from pdcd.capture.worker.spawned import SpawnedWorker
    from pdcd.child import Child
    from pdcd.virtual.optics.bench import OpticalBench

logger = logging.getLogger(__name__)

_Asked = Callable[[], bool]
"""Whether the job is to end; called at every step, which also shows that the thread is alive."""


def _unheard(event: Event) -> None:
    """Ignore an event."""


def _at_once(text: str) -> None:
    """Return at once: nobody is there to do what is asked."""


def _never() -> bool:
    """Never cancel."""
    return False


class Engine:
    """One rig and all that can be done with it. Not for use from two threads at once."""

    def __init__(
        self, config: Config, worker: Callable[[RigFacts], WorkerProxy] = InProcessWorker
    ) -> None:
        self._asked, self._make_worker = config, worker
        self._note = ""
        self._held: int | None = None
        self._broken_off = threading.Event()
        self._set_up(choose_calibration(config))

    def _set_up(self, chosen: CalibrationChoice) -> None:
        """Make the rig of a configuration with its calibration, closed, and its worker."""
        if chosen.words and chosen.words != self._note:
            logger.info("%s", chosen.words, extra={"for_people": True})
        self._note = chosen.words
        config = with_grid(chosen.config)
        rig, profile = self._make_rig(config), load_profile(config.camera.profile)
        self._worker = self._make_worker(
            RigFacts(config, profile, rig.grid, rig.scene, rig.cells_meet)
        )
        self._config, self._rig, self._profile = config, rig, profile

    def _make_rig(self, config: Config) -> Rig:
        rig = self._in_use = Rig(config, self._broken_off.is_set)
        return rig

    @classmethod
    def from_config(cls, config: Config) -> Engine:
        """The engine of a configuration, which plans and decodes in this process.

        Raises DriverUnavailable and ConfigError.
        """
        return cls(config)

    @classmethod
    def with_child(cls, config: Config, child: Child[Any] | None = None) -> Engine:
        """An engine that plans and decodes in a process of its own, whose death does no harm to
        this one. It must be used in one thread, which lives as long as the engine is needed.
        `child` is that process, where it was started already."""
        from pdcd.capture.worker.spawned import SpawnedWorker  # nobody else has one

        ready = [] if child is None else [child]

        def spawned(facts: RigFacts) -> SpawnedWorker:
            return SpawnedWorker(facts, child=ready.pop() if ready else None)

        return cls(config, spawned)

    def start(self) -> None:
        """Open the rig. On return panels are black, the shutter is closed, the camera answers."""
        self._open()
        used, rig = self._config.calibration, self._rig
        if self._asked.calibration.use != "latest" or used.sha256 is None:
            return
        record, _ = read_calibration(Path(used.use))
        if find_other_device(record, rig.camera_info, rig.display_info) is None:
            return
        # Nobody named this calibration: use another one that fits the devices, or none.
        found = choose_calibration(self._asked, rig.camera_info, rig.display_info)
        if found.config.calibration.sha256 != used.sha256:
            self.stop()
            self._set_up(found)
            self._open()

    def _open(self) -> None:
        used = self._config.calibration
        if used.sha256 is not None and self._held is None:
            self._held = lock_calibration_in_use(Path(used.use))
        self._worker.start()  # it takes a while to warm up, as devices do
        self._rig.connect()

    def stop(self) -> None:
        """Make safe and release the rig. Idempotent."""
        if self._held is not None:
            os.close(self._held)
            self._held = None
        try:
            self._rig.disconnect()
        finally:
            self._worker.stop()

    def break_off(self) -> None:
        """Make all drivers stop waiting, for good: the process is about to end. For any thread."""
        self._broken_off.set()

    def make_safe_beside(self, within_s: float) -> bool:
        """Make panels black and close the shutter, from another thread, while the engine's own
        hangs in a driver. Returns whether both were done within that time."""
        return self._in_use.make_safe_beside(within_s)

    @property
    def deaf_s(self) -> float:
        """For how long devices have kept a job waiting to be made safe; 0 while none does. For any
        thread."""
        since_s = self._in_use.deaf_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of code cells."""
        return self._rig.grid

    @property
    def note(self) -> str:
        """Which calibrations were skipped, and why, in a line; "" for none."""
        return self._note

    @property
    def optics(self) -> OpticalBench | None:
        """What a mock camera sees, pixel by pixel, once it is open; None for a real one, and where
        the scene's cells contain everything there is to see."""
        from pdcd.virtual.optics.needed import choose_optics  # nothing waits for its pixels

        scene = self._rig.scene
        return None if scene is None else choose_optics(self._config, scene)

    def describe(self) -> RigView:
        """The rig: drivers, panels, camera, scene."""
        return describe_rig(self._rig)

    def plan(
        self,
        request: CaptureRequest,
        given: Given = NO_ARRAYS,
        *,
        emit: Emit = _unheard,
        cancelled: _Asked = _never,
    ) -> PlanSummary:
        """What a request would do; `given` holds its arrays.

        `emit` hears of the progress of the plan; `cancelled()` is called as in a capture. Raises
        RequestError, PlanError, Cancelled.
        """

        def look_for_cancel() -> None:
            if cancelled():
                raise Cancelled("the plan was cancelled", hint="nothing was exposed")

        look_for_cancel()
        choice = is_search_needed(request)
        camera = self._rig.camera
        with self._rig.pulse.of_job(cancelled):
            # A plain plan does not need a real camera that is not open.
            if camera is None and (choice or (self._rig.mock and is_camera_needed(request))):
                camera = self._rig.look_at_camera()
            asked = choice or is_lag_needed(request, self._config)
            lag_s = self._rig.mask_lag_s() if asked else None
        watch = make_planning_watch(emit, look_for_cancel)
        return self._worker.do(watch, Worker.plan, request, dict(given), camera, lag_s).summary

    def show(self, pattern: str, index: int = 0) -> None:
        """Hold a pattern on both panels: black, white, checker, grid, or one code by its number.

        Raises DeviceLost when the panels do not go black.
        """
        frames = self._make_still(pattern, index)
        if frames is not None:
            self._rig.display.show(frames)
        elif not self._rig.make_safe():
            raise DeviceLost(
                "the panels may still be lit", device="display", hint="see the daemon's log"
            )

    def _make_still(self, pattern: str, index: int) -> Frames | None:
        if pattern == "black":
            return None
        from pdcd.capture.show import make_pattern_frames  # no capture waits for what to look at

        return make_pattern_frames(pattern, index, self.grid, self._config)

    def preview(
        self,
        *,
        job: str,
        owner: OwnerView | None = None,
        emit: Emit = _unheard,
        cancelled: _Asked = _never,
    ) -> PreviewView:
        """Take a short white photo and store it as PNG below the state folder, which keeps the last
        few.

        `emit` and `cancelled` are those of `capture`. Raises the error with which the photo ended.
        """
        from pdcd.capture.previews import read_preview, remove_old_previews  # no capture has it

        request = CaptureRequest(
            goal="white", codes=4, window="whole", guards=False, black_level="none"
        )
        with HeldFolder.at(find_state_dir(self._config) / "preview") as parent:
            result = self.capture(
                request, job=job, owner=owner, emit=emit, cancelled=cancelled, parent=parent
            )
            remove_old_previews(parent.path)
        return read_preview(result)

    def live(
        self,
        pattern: str,
        index: int = 0,
        *,
        job: str,
        tell: Callable[[LiveFrame], object],
        cancelled: _Asked,
        ended: _Asked = _never,
    ) -> CaptureResult:
        """Show what the camera's finder sees while the panels hold a pattern of `show`, until
        `cancelled()` or `ended()`. Errors are in the result, not raised, and the rig is left as
        after `capture`. `tell` receives each picture."""
        from pdcd.capture.live import run_live_view  # nobody else waits for finders

        return run_live_view(
            self._rig,
            lambda: self._make_still(pattern, index),
            job=job,
            tell=tell,
            cancelled=cancelled,
            ended=ended,
        )

    def stream(
        self,
        request: StreamRequest,
        given: Given = NO_ARRAYS,
        *,
        job: str,
        owner: OwnerView | None = None,
        emit: Emit = _unheard,
        listener: StreamListener,
    ) -> CaptureResult:
        """Take photo after photo with one plan until the listener ends it or its time is over, with
        the guarantees of `capture`. `emit` hears of the first photos, and of runs made from
        them."""
        from pdcd.capture.streaming import StreamBench, run_stream  # no capture waits for it

        notes = (*filter(None, [self._note]), *self._rig.display_warnings)
        bench = StreamBench(
            self._config, self._rig, self._profile, self._worker, notes, self.describe
        )
        return run_stream(bench, request, given, job, owner, emit, listener)

    def capture(
        self,
        request: CaptureRequest,
        given: Given = NO_ARRAYS,
        *,
        job: str,
        owner: OwnerView | None = None,
        emit: Emit,
        cancelled: Callable[[], bool],
        parent: HeldFolder | None = None,
        report: bool = False,
    ) -> CaptureResult:
        """Run one job to its end; errors of the job are in the result, not raised.

        When it returns, panels are black and the shutter is closed, whatever the result says; where
        a device refuses that, the last warning says so.
        `given` holds the arrays of the request: no file that a request names is opened here.
        `emit(event)` hears of every step; `cancelled()` is called at each of them. The run goes
        into `parent`, which stays open; without it, to where request and configuration say. With
        `report` it gets its page (`pdcd.pages.report`) at once, if that is cheap.
        """
        ordered = EngineJob(job, request, owner, emit, cancelled, given, report)
        safe, folder, run, failure = False, None, None, None
        with ExitStack() as held:
            held.enter_context(self._rig.pulse.of_job(cancelled))
            try:
                place = parent or held.enter_context(HeldFolder.at(self._out(request)))
                folder = held.enter_context(RunFolder(place, job))
                notes = (*filter(None, [self._note]), *self._rig.display_warnings)
                run = CaptureRun(
                    self._config, self._rig, self._profile, self._worker, folder, ordered, notes
                )
                result = run.execute(self.describe())
            except BaseException as err:
                failure = to_job_error(err, "capture", job)
            finally:
                safe = self._rig.make_safe()
            if failure is not None:
                taken = None if run is None else run.taken
                warnings = () if run is None else run.warnings
                now_ns = self._rig.clock.now_ns()
                result = make_failure(
                    job, folder, now_ns, failure, safe=safe, taken=taken, warnings=warnings
                )
        return result if safe else mark_unsafe(result)

    def calibrate(
        self,
        request: CalibrateRequest,
        *,
        job: str,
        emit: Emit,
        cancelled: _Asked,
        proceed: Callable[[str], None] = _at_once,
        out: Path | None = None,
    ) -> CaptureResult:
        """Let the bench measure itself; errors of the job are in the result, not raised.

        When it returns, panels are black and the shutter is closed. The results that are not bad
        are in use from then on, also where the calibration stopped. `proceed(text)` returns once
        somebody has done what the text asks; `emit` and `cancelled` are those of `capture`. A mock
        bench puts up its own card, if one is needed. `out` : where the folder is made; a link in
        the state folder then leads to it. None: in the state folder itself.
        Raises ConfigError where the rig cannot be made with the measured values; it then goes on as
        it was.
        """
        from pdcd.capture.calibrate import FOLDERS, CalibrationRun  # no start waits for the steps

        rig = self._rig if request.subject == "scene" else self._with_card()
        safe, folder, failure, run = False, None, None, None
        with ExitStack() as held:
            held.enter_context(rig.pulse.of_job(cancelled))
            try:
                place = held.enter_context(HeldFolder.at(out or self._calibrations))
                folder = held.enter_context(RunFolder(place, job, below=FOLDERS))
                run = CalibrationRun(
                    self._config, rig, self._profile, self._worker, folder, job, request, emit,
                    cancelled, proceed, self._asked,
                )  # fmt: skip
                try:
                    result = run.execute()
                finally:
                    if out is not None and run.ended_whole and folder.where is not None:
                        link_calibration(folder.where, self._calibrations)
            except BaseException as err:
                failure = to_job_error(err, "calibration", job)
            finally:
                safe = rig.make_safe()
                if rig is not self._rig:
                    rig.disconnect()
                    self._in_use = self._rig
                    self._rig.connect()
            whole = failure is None or (run is not None and run.ended_whole)
            if failure is not None:
                now_ns = self._rig.clock.now_ns()
                result = make_failure(job, folder, now_ns, failure, safe=safe, log=not whole)
                result = msgspec.structs.replace(result, passed=False)
                if whole and run is not None:
                    result = mark_kept(result, run.kept)
        result = result if safe else mark_unsafe(result)
        # Only now: the rig may be another one from here on.
        if whole and not isinstance(failure, DeviceLost):
            self._adopt()
            result = mark_used(result, self._config)
        return result

    @property
    def _calibrations(self) -> Path:
        return find_state_dir(self._config) / CALIBRATIONS_FOLDER

    def _with_card(self) -> Rig:
        """The rig in front of a white card: the scene of a mock bench is taken away meanwhile."""
        if not self._rig.mock or self._config.scene.kind == CARD:
            return self._rig
        rows, cols = self.grid
        scene = SceneConfig(kind=CARD, grid=(rows, cols), ambient=self._config.scene.ambient)
        rig = self._make_rig(msgspec.structs.replace(self._config, scene=scene))
        self._rig.disconnect()
        try:
            rig.connect()
        except BaseException:
            self._rig.connect()
            raise
        return rig

    def _adopt(self) -> None:
        """Use the newest calibration from here on, where the configuration asks for that."""
        if self._asked.calibration.use != "latest":
            return
        was_open = self._rig.camera_info is not None
        self.stop()
        try:
            self._set_up(choose_calibration(self._asked))
        finally:  # with the old configuration where the measured values cannot be used
            if was_open:
                self.start()

    def _out(self, request: CaptureRequest) -> Path:
        """The folder for runs where the caller holds none open."""
        return Path(request.out) if request.out else find_state_dir(self._config) / "captures"
