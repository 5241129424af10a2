"""A bench in this process: the mock bench, or real devices that no daemon holds."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from pdcd.api.arguments import to_json_types
from pdcd.api.bench import NONE, Arrays, Bench
from pdcd.api.progress import EventListener
from pdcd.api.signals import hold_signals
from pdcd.api.stream import LocalStream, PictureStream
from pdcd.bench.config import from_config_tables, load_config
from pdcd.bench.measured import apply_calibration
from pdcd.bench.reading import check_integers, parse_toml
from pdcd.bench.tables import Config
from pdcd.errors import BusyError, ConfigError, PdcdError
from pdcd.files.opening import UnsoundFileError, open_parcels
from pdcd.files.reading import MAX_PICTURE_BYTES, hash_file
from pdcd.files.system import require_linux
from pdcd.planning.stream_set import make_set_request
from pdcd.protocol.events import Event
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.protocol.stream import StreamRequest
from pdcd.protocol.views import OwnerView
from pdcd.runs.recording import StreamListener

if TYPE_CHECKING:
    from pdcd.capture.engine import Engine
    from pdcd.recipes.arrays import Given
    from pdcd.virtual.optics.bench import OpticalBench

Configured = Config | Path | str | Mapping[str, Any] | None
"""A configuration: None, the path of a TOML file, TOML text, or tables."""


def local(config: Configured = None, *, folder: Path | str | None = None) -> LocalBench:
    """A bench in this process.

    Parameters
    ----------
    config : None for the configuration that `pdcd` itself would use, which is the mock bench if
        there is no file; the path of a file; TOML text, which is any `str` with a line break or a
        `=` in it; or tables, such as ``{"scene": {"kind": "wax-disk"}}``.
    folder : where run folders go; None: below the state folder, as the configuration says.

    Raises ConfigError and DriverUnavailable. The devices are opened by the first capture.
    """
    return LocalBench(resolve_config(config), None if folder is None else Path(folder))


def resolve_config(given: Configured, base: Config | None = None) -> Config:
    """The configuration that was given in one of the ways of `local`. Raises ConfigError.

    base : values of the keys that text or tables leave out; None: those of the mock bench.
    """
    if isinstance(given, Config):
        return given
    if isinstance(given, Mapping):
        called = "the tables given"
        return from_config_tables(check_integers(to_json_types(given), called), called, base)
    if isinstance(given, str) and ("\n" in given or "=" in given):
        called = "the text given"
        return from_config_tables(parse_toml(given, called), called, base)
    if not isinstance(given, str | os.PathLike | None):
        raise ConfigError(
            f"a configuration of type {type(given).__name__} was given",
            hint="give the path of a file, TOML text, tables, or None",
        )
    return load_config(given)


class LocalBench(Bench):
    """A bench in this process. It opens at its first use, and again at the first after `close`."""

    def __init__(self, config: Config, folder: Path | None = None) -> None:
        require_linux("a bench")
        from pdcd.capture.engine import Engine

        self._config = config
        self._engine: Engine = Engine.from_config(config)
        self._folder = folder
        self._opened = False
        self._used = threading.Lock()
        self._stream: Callable[[], LocalStream | None] = lambda: None

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of code cells."""
        return self._engine.grid

    @property
    def note(self) -> str:
        """Which calibrations were passed over, and why, in a line; "" for none."""
        return self._engine.note

    @property
    def optics(self) -> OpticalBench | None:
        """The virtual bench that photos are made of (`Engine.optics`)."""
        return self._engine.optics

    def described(self) -> dict[str, Any]:
        """The configuration in plain values, its files by their content."""
        return describe_bench(self._config)

    def close(self) -> None:
        """Release the devices, and end a running stream. Idempotent; the next capture opens the
        devices again."""
        if (stream := self._stream()) is not None:
            stream.close()
        if self._opened:
            self._opened = False
            self._engine.stop()

    def foresee(self, request: CaptureRequest, arrays: Arrays = NONE) -> PlanSummary:
        """What a request would do; no device is opened for it. Raises RequestError, or BusyError
        while there is a photo or a stream, whose plan would be lost."""
        wanted = self._read(request, arrays)
        self._begin_use()
        try:
            return self._engine.plan(*wanted)
        finally:
            self._used.release()

    def take(
        self,
        request: CaptureRequest,
        arrays: Arrays = NONE,
        *,
        on_event: EventListener | None = None,
        report: bool = False,
    ) -> CaptureResult:
        """Take the photo of a request (see `Bench.take`)."""
        with hold_signals() as interrupted:
            return self.take_until(interrupted, request, arrays, on_event, report=report)

    def take_until(
        self,
        cancelled: Callable[[], bool],
        request: CaptureRequest,
        arrays: Arrays,
        on_event: EventListener | None,
        *,
        report: bool,
    ) -> CaptureResult:
        """The same, but ended when `cancelled()` is true, which is asked at every step; `report` is
        that of `Engine.capture`."""
        if request.out is None and self._folder is not None:
            request = msgspec.structs.replace(request, out=str(self._folder.absolute()))
        wanted, given = self._read(request, arrays)
        self._begin_use()
        try:
            self._open()
            return self._engine.capture(
                wanted,
                given,
                job=make_job_id(),
                owner=describe_owner(),
                emit=_unheard if on_event is None else on_event,
                cancelled=cancelled,
                report=report,
            )
        finally:
            self._used.release()

    def begin_stream(self, request: StreamRequest, arrays: Arrays = NONE) -> PictureStream:
        """Begin a stream (see `Bench.begin_stream`); until it ends, the bench does nothing else."""
        return self.stream_drawn(request, arrays, draw=False)

    def stream_drawn(
        self, request: StreamRequest, arrays: Arrays = NONE, *, draw: bool
    ) -> LocalStream:
        """The same; with `draw`, pictures are also drawn as JPEGs."""
        make_set_request(request)  # a request that cannot be streamed is refused at once
        wanted, given = self._read(request, arrays)
        if not isinstance(wanted, StreamRequest):
            raise PdcdError("a stream became a photo")
        asked = wanted

        def run(listener: StreamListener) -> CaptureResult:
            try:
                return self._engine.stream(
                    asked, given, job=make_job_id(), owner=describe_owner(), listener=listener
                )
            finally:
                self._used.release()

        self._begin_use()
        try:
            self._open()
        except BaseException:
            self._used.release()
            raise
        stream = LocalStream(run, draw=draw)
        self._stream = weakref.ref(stream)  # the stream ends when nothing else holds it
        return stream

    def _begin_use(self) -> None:
        """Reserve the rig for one photo or stream. Raises BusyError while there is another one."""
        if not self._used.acquire(blocking=False):
            raise BusyError(
                "this bench is taking a photo or a stream", hint="wait for its end, or end it first"
            )

    def _open(self) -> None:
        if self._opened:
            return
        self._opened = True
        try:
            self._engine.start()
        except BaseException:  # some devices may be open already
            self.close()
            raise

    def _read(self, request: CaptureRequest, arrays: Arrays) -> tuple[CaptureRequest, Given]:
        """Read the arrays with this user's rights. Raises RequestError."""
        from pdcd.planning.given import make_descriptor_source, read_request_arrays

        with open_parcels(arrays) as opened:
            sources = {n: make_descriptor_source(p.descriptor, p.file) for n, p in opened.items()}
            return read_request_arrays(request, sources, self.grid)


def describe_bench(config: Config) -> dict[str, Any]:
    """A configuration in plain values, with the measurements of the calibration it asks for, and
    the SHA-256 of the files that it names. Raises ConfigError for an unusable calibration."""
    config = apply_calibration(config)
    names = (config.scene.path, config.bench.truth, config.camera.profile)
    files = [Path(name) for name in names if name is not None]
    sums = {}
    for file in files:
        with suppress(UnsoundFileError):  # names of bundled profiles are not files
            sums[str(file)] = hash_file(file, MAX_PICTURE_BYTES)
    return {"config": msgspec.to_builtins(config), "files": sums}


def describe_owner() -> OwnerView:
    """The user of this process, as a daemon would learn it from the kernel."""
    import pwd  # missing on Windows, where runs are only read

    uid = os.getuid()
    try:
        user = pwd.getpwuid(uid).pw_name
    except KeyError:  # containers may run as users without a name
        user = str(uid)
    return OwnerView(uid=uid, pid=os.getpid(), user=user)


def _unheard(event: Event) -> None:
    """Ignore an event: nobody listens."""
