"""A stream from beginning to end: a scratch folder, a first set of photos, the loop, runs that are
recorded from it, and a rig that is made safe whatever happens."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import msgspec

from pdcd.bench.folders import find_state_dir
from pdcd.bench.tables import Config
from pdcd.capture.job import EngineJob, make_failure, mark_unsafe, to_job_error
from pdcd.capture.rig import Rig
from pdcd.capture.run import CaptureRun
from pdcd.capture.shots import TakenShot
from pdcd.capture.stream import PictureMaker, StreamTaker
from pdcd.capture.worker.proxy import WorkerProxy
from pdcd.capture.worker.worker import Worker
from pdcd.errors import PdcdError, disk_errors
from pdcd.planning.stream_set import make_set_request
from pdcd.protocol.events import Emit
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamRequest
from pdcd.protocol.views import OwnerView, RigView
from pdcd.recipes.arrays import Given
from pdcd.runs.folder import RunFolder
from pdcd.runs.place import HeldFolder
from pdcd.runs.recording import RecordOrder, StreamListener
from pdcd.sensor.profile import SensorProfile
from pdcd.watch import Watch

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class StreamBench:
    """The parts of an engine that a stream uses. notes : what the user should know of the bench."""

    config: Config
    rig: Rig
    profile: SensorProfile
    worker: WorkerProxy
    notes: tuple[str, ...]
    describe: Callable[[], RigView]

    def make_run(
        self, order: EngineJob, folder: RunFolder, shown: dict[str, TakenShot] | None = None
    ) -> CaptureRun:
        """The run of a job on the rig. shown : receives all shots by name."""
        return CaptureRun(
            self.config, self.rig, self.profile, self.worker, folder, order, self.notes, shown
        )


def run_stream(
    bench: StreamBench,
    request: StreamRequest,
    given: Given,
    job: str,
    owner: OwnerView | None,
    emit: Emit,
    listener: StreamListener,
) -> CaptureResult:
    """Run a stream to its end (`Engine.stream`); errors are in the result, not raised. On return
    panels are black and the shutter is closed, or the last warning says that they may not be."""
    rig = bench.rig
    failure: PdcdError | None = None
    maker = PictureMaker(bench.worker, request.goal, listener)
    with ExitStack() as held:
        held.enter_context(rig.pulse.of_job(listener.cancelled))
        try:
            wanted = make_set_request(request)
            ordered = EngineJob(job, wanted, owner, emit, listener.cancelled, given)
            folder = held.enter_context(_scratch_folder(bench.config, job, held))
            _take_stream(bench, request, ordered, folder, maker, listener)
        except BaseException as err:
            failure = to_job_error(err, "stream", job)
        finally:
            safe = rig.make_safe()
            maker.end()
            _forget(bench.worker)
    if failure is None:
        result = CaptureResult(job=job, state="done", summary={"pictures": maker.count})
    else:
        result = make_failure(job, None, rig.clock.now_ns(), failure, safe=safe)
    return result if safe else mark_unsafe(result)


def _forget(worker: WorkerProxy) -> None:
    """Make the worker forget the photos; if that fails, the next job does it."""
    try:
        worker.do(Watch(), Worker.forget)
    except PdcdError as err:
        logger.warning("photos of a stream not forgotten error=%s", err)


def _take_stream(
    bench: StreamBench,
    request: StreamRequest,
    ordered: EngineJob,
    folder: RunFolder,
    maker: PictureMaker,
    listener: StreamListener,
) -> None:
    """Take the first set, then photos until the end. Raises whatever ends it other than its
    time."""
    shown: dict[str, TakenShot] = {}
    first = bench.make_run(ordered, folder, shown)
    view = bench.describe()
    first.take_photos(view)
    rounds = bench.worker.do(ordered.watch(), Worker.roll, request.over)
    taker = StreamTaker(bench.config, bench.rig, ordered, request, rounds, folder.path, shown)

    def record(order: RecordOrder, taken: Mapping[str, TakenShot]) -> None:
        order.done(_record(bench, order, ordered, first, taken, view))

    maker.start()
    taker.run(maker, listener.next_record, record)


def _scratch_folder(config: Config, job: str, held: ExitStack) -> RunFolder:
    """A run folder for the first photos, which is removed once the stream has ended."""
    state = find_state_dir(config)
    with disk_errors(str(state)):
        state.mkdir(parents=True, exist_ok=True)
        scratch = held.enter_context(tempfile.TemporaryDirectory(prefix="stream-", dir=state))
    return RunFolder(held.enter_context(HeldFolder.at(Path(scratch))), job)


def _record(
    bench: StreamBench,
    order: RecordOrder,
    ordered: EngineJob,
    first: CaptureRun,
    taken: Mapping[str, TakenShot],
    view: RigView,
) -> CaptureResult:
    """Make a run of the newest photos; an error in it does not end the stream."""
    request = msgspec.structs.replace(ordered.request, keep_raw="all")
    wanted = EngineJob(
        order.job, request, ordered.owner, ordered.emit, ordered.cancelled, ordered.given, True
    )
    with ExitStack() as held:
        folder: RunFolder | None = None
        try:
            place = order.place or held.enter_context(HeldFolder.at(_runs_folder(bench.config)))
            folder = held.enter_context(RunFolder(place, order.job))
            return bench.make_run(wanted, folder).record(first, taken, view)
        except Exception as err:
            typed, now_ns = to_job_error(err, "record", order.job), bench.rig.clock.now_ns()
            return make_failure(order.job, folder, now_ns, typed, safe=True)


def _runs_folder(config: Config) -> Path:
    return find_state_dir(config) / "captures"
