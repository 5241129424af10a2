"""A bench of another package: panels, shutter and camera in front of a card that is grey in steps.

It knows nothing of pdcd but `pdcd.driver`. The camera sees each pixel of the panels in one quad.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import (
    CameraInfo,
    CameraSettings,
    Cancelled,
    Clock,
    Config,
    ConfigError,
    Display,
    DisplayInfo,
    DriverContext,
    ExposureError,
    FrameLog,
    Frames,
    RawFile,
    Readout,
    Shutter,
    check_fit,
    check_row_times,
    draw,
    panels_of,
    play_all,
    responsivity_e,
    streams,
    write_dng,
)

REFRESH_HZ = 60.0
BLACK_DN, WHITE_DN, GAIN_E_PER_DN = 64, 4095, 10.0


def card(width: int, height: int) -> NDArray[np.float64]:
    """What the card sends back of the light, (height, width): four steps, dark to bright."""
    return np.tile(np.repeat([0.2, 0.4, 0.6, 0.8], -(-width // 4))[:width], (height, 1))


class Bench:
    """What the three drivers of one rig have in common."""

    def __init__(self, config: Config) -> None:
        width, height = config.projector.size_px
        self.albedo = card(width, height)
        self.light_s = np.zeros((height, width))
        self.open_ns: int | None = None
        self.closed_ns: int | None = None

    @classmethod
    def of(cls, context: DriverContext) -> Bench:
        """The one of this rig."""
        return context.the(cls, lambda: cls(context.config))

    def lit(self, picture: NDArray[np.float64], seconds: float) -> None:
        """Light through the mask for that time; it counts while the shutter is open."""
        if self.open_ns is not None:
            self.light_s += picture * self.albedo * seconds


class Panels:
    """Projector and mask, drawn by the processor."""

    maturity = "experimental"

    def __init__(self, context: DriverContext) -> None:
        self._config, self._clock = context.config, context.clock
        self._views = panels_of(context.config)
        self._bench = Bench.of(context)
        self._frames: Frames | None = None

    @classmethod
    def create(cls, context: DriverContext) -> Panels:
        return cls(context)

    def connect(self) -> DisplayInfo:
        sizes = self._config.projector.size_px, self._config.mask.size_px
        return DisplayInfo(*sizes, REFRESH_HZ, {"projector": "stranger"}, mask_lag_s=0.0)

    def load(self, frames: Frames) -> None:
        self._frames = None
        check_row_times(frames)
        check_fit(frames, self._views.projector)
        check_fit(frames, self._views.mask)
        self._frames = frames

    def black(self) -> None:
        """Nothing is shown but by `play`."""

    def show(self, frames: Frames) -> None:
        self.load(frames)

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        frames, config = self._frames, self._config
        if frames is None:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")

        def once(rows: NDArray[np.int32]) -> FrameLog:
            primal, dual = streams(rows, config.display.mask_delay_refreshes)
            count = len(primal)
            at = self._clock.now_ns() + np.rint(np.arange(count + 1) * 1e9 / REFRESH_HZ)
            stamps = at.astype(np.int64)
            for number in range(count):
                if number % 6 == 0:
                    progress(number, count, 0)
                    if cancelled():
                        raise Cancelled("cancelled", device="display")
                light = draw(frames, self._views.projector, int(primal[number])) / 255.0
                mask = draw(frames, self._views.mask, int(dual[number])) / 255.0
                self._clock.sleep_until_ns(int(stamps[number + 1]))
                self._bench.lit(light * mask, 1.0 / REFRESH_HZ)
            progress(count, count, 0)
            none = np.zeros(count, dtype=np.int32)
            times = stamps[:-1], stamps[:-1].copy(), stamps[[-1, -1]]
            return FrameLog(primal, dual, *times, none, "stranger", True, primal, dual)

        rig = config.rig
        return play_all(once, frames, on_miss=rig.on_miss, rounds=rig.retries, row_hz=REFRESH_HZ)

    def disconnect(self) -> None:
        self._frames = None


class Blades:
    """A shutter without lag."""

    maturity = "experimental"

    def __init__(self, bench: Bench, clock: Clock) -> None:
        self._bench, self._clock = bench, clock

    @classmethod
    def create(cls, context: DriverContext) -> Blades:
        return cls(Bench.of(context), context.clock)

    def connect(self) -> dict[str, str]:
        self.close()
        return {"model": "stranger's blades"}

    def open(self) -> int:
        bench = self._bench
        bench.light_s[:] = 0.0
        bench.open_ns, bench.closed_ns = self._clock.now_ns(), None
        return bench.open_ns

    def close(self) -> int:
        bench, now_ns = self._bench, self._clock.now_ns()
        if bench.open_ns is not None and bench.closed_ns is None:
            bench.closed_ns = now_ns
        return now_ns

    def disconnect(self) -> None:
        self.close()


class Camera:
    """Hands its samples over as a DNG of its own."""

    maturity = "experimental"

    def __init__(self, context: DriverContext) -> None:
        self._bench, self._config = Bench.of(context), context.config.camera
        self._settings: CameraSettings | None = None

    @classmethod
    def create(cls, context: DriverContext) -> Camera:
        return cls(context)

    def connect(self) -> CameraInfo:
        height, width = self._bench.albedo.shape
        return CameraInfo(
            model="Stranger One",
            serial="0001",
            profile=self._config.profile,
            responsivity_e=responsivity_e(self._config),
            isos=(100,),
            f_numbers=(),
            frame_quads=(width, height),
        )

    def arm(self, settings: CameraSettings) -> None:
        if settings.iso != 100:
            raise ConfigError(f"no ISO {settings.iso}", device="camera", hint="take 100")
        self._settings = settings

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        bench, settings, self._settings = self._bench, self._settings, None
        if settings is None:
            raise ExposureError("the camera was not armed", device="camera", hint="call arm first")
        if bench.open_ns is None or bench.closed_ns is None:
            raise ExposureError("there is no photo", device="camera", hint="open and close")
        exposure_s = (bench.closed_ns - bench.open_ns) * 1e-9
        bench.open_ns = bench.closed_ns = None
        return write_dng(
            folder / f"{name}.dng",
            self._samples(),
            black=BLACK_DN,
            white=WHITE_DN,
            iso=settings.iso,
            exposure_s=exposure_s,
            model="Stranger One",
            serial="0001",
        )

    def _samples(self) -> NDArray[np.uint16]:
        """The light that fell on it, as an RGGB mosaic."""
        f_number = float(self._config.f_number)
        electrons = self._bench.light_s[..., None] * responsivity_e(self._config) / f_number**2
        mosaic = electrons[..., [0, 1, 1, 2]].reshape(*electrons.shape[:2], 2, 2)
        mosaic = mosaic.transpose(0, 2, 1, 3).reshape(*(2 * n for n in electrons.shape[:2]))
        samples = np.rint(BLACK_DN + mosaic / GAIN_E_PER_DN)
        return np.asarray(np.minimum(samples, WHITE_DN), dtype=np.uint16)

    def disconnect(self) -> None:
        self._settings = None


def _conforms(context: DriverContext) -> tuple[Display, Shutter, Readout]:
    """Let a type checker compare the classes with their Protocols."""
    return Panels.create(context), Blades.create(context), Camera.create(context)
