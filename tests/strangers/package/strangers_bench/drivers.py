"""What pdcd sees of the bench: a display, a shutter and a camera.

Options of all three: `facts`, the file of what the bench is (`Facts.save`), and beside it
`stands.json`, what stands there now (`Stands.save`), which is read anew for each photo.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.driver import (
    BLACK,
    CameraInfo,
    CameraSettings,
    Cancelled,
    Clock,
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
    draw,
    panels_of,
    play_all,
    read_options,
    responsivity_e,
    streams,
    write_dng,
)

from .facts import CAMERAS, ENGRAVED, Facts
from .panels import Picture
from .world import Shown, Stands, World

REFRESH_HZ = 60.0
STANDS = "stands.json"
DARK = -1
"""Number of the picture that is black."""
SETTLES_NS = 300_000_000
"""After which no panel tells what it showed before."""


class Options(msgspec.Struct, frozen=True):
    """[display.options], [trigger.options] and [camera.options]."""

    facts: str


class Bench:
    """What the drivers of one rig share: what was sent when, and when the shutter was open."""

    def __init__(self, context: DriverContext) -> None:
        options = read_options(
            context.config.display.options, Options, table="display.options", device="display",
            hint="facts is the file of what the bench is",
        )  # fmt: skip
        self._file = Path(options.facts)
        self.facts = Facts.load(self._file)
        self.panels = panels_of(context.config)
        self._text = b"?"
        self.stands = Stands()
        self._world: World | None = None
        self._photos = 0
        self._sent: list[list[tuple[int, int]]] = [[], []]
        self._pictures: list[dict[object, tuple[int, Frames, int]]] = [{}, {}]
        self.open_ns: int | None = None
        self.closed_ns: int | None = None
        self.rng = np.random.default_rng([self.facts.seed, 9])

    @classmethod
    def of(cls, context: DriverContext) -> Bench:
        """The one of this rig. Raises ConfigError."""
        return context.the(cls, lambda: cls(context))

    @property
    def world(self) -> World:
        """The bench as it stands now."""
        self.look()
        if self._world is None:
            self._world = World(self.facts, self.stands)
        return self._world

    def look(self) -> Stands:
        """Read what the judge has written since."""
        file = self._file.parent / STANDS
        text = file.read_bytes() if file.exists() else b""
        if text != self._text:
            self._text, self._world, self._photos = text, None, 0
            self.stands = Stands.load(file)
        return self.stands

    def send(self, side: int, at_ns: int, frames: Frames | None, row: int) -> None:
        """Panel `side` (0 projector, 1 mask) is sent a row of frames, or black, at that time."""
        number = DARK
        if frames is not None and row != BLACK:
            index = int((frames.primal_index, frames.dual_index)[side][row])
            if index != BLACK:
                shift = int(frames.shift[row]) if index >= 0 or frames.window != "pixels" else 0
                key = (id(frames), index, shift)
                known = self._pictures[side]
                number = known.setdefault(key, (len(known), frames, row))[0]
        sent = self._sent[side]
        if (sent[-1][1] if sent else DARK) != number:
            sent.append((at_ns, number))

    def forget(self, now_ns: int) -> None:
        """An exposure begins: what panels show now, and what they have not settled from, counts;
        what was shown before is over."""
        for side in (0, 1):
            sent, pictures = self._sent[side], self._pictures[side]
            late = [at > now_ns - SETTLES_NS for at, _ in sent]
            del sent[: max(late.index(True) if any(late) else len(sent), 1) - 1]
            used = {number for _, number in sent} - {DARK}
            again = {number: place for place, number in enumerate(sorted(used))}
            self._pictures[side] = {
                key: (again[number], frames, row)
                for key, (number, frames, row) in pictures.items()
                if number in used
            }
            sent[:] = [(at, again.get(number, DARK)) for at, number in sent]

    def shown(self) -> Shown:
        """What the panels were sent since, pictures included."""
        origin = self.open_ns or 0
        times, numbers, pictures = [], [], []
        for side, view in enumerate((self.panels.projector, self.panels.mask)):
            sent = self._sent[side] or [(origin, DARK)]
            times.append(np.array([(at - origin) * 1e-9 for at, _ in sent]))
            numbers.append(np.array([number for _, number in sent]))
            drawn: list[Picture] = [
                draw(f, view, row) for _, f, row in self._pictures[side].values()
            ]
            pictures.append(drawn)
        return Shown(times[0], numbers[0], times[1], numbers[1], pictures[0], pictures[1])

    def room(self) -> float:
        """The room's light on this photo."""
        self._photos += 1
        stands = self.stands
        later = stands.room_later is not None and self._photos > stands.room_after
        return float(stands.room_later or 0.0) if later else self.facts.room


class Panels:
    """Both panels on one graphics card: in step, whatever each is late by."""

    maturity = "experimental"

    def __init__(self, context: DriverContext) -> None:
        self._config, self._clock = context.config, context.clock
        self._bench = Bench.of(context)
        self._frames: Frames | None = None

    @classmethod
    def create(cls, context: DriverContext) -> Panels:
        """The panels of a rig. Raises ConfigError."""
        return cls(context)

    def connect(self) -> DisplayInfo:
        """Both are black."""
        facts = self._bench.facts
        names = {"projector": f"foreign {facts.seed}", "mask": f"foreign {facts.seed}"}
        return DisplayInfo(facts.projector.size_px, facts.mask.size_px, REFRESH_HZ, names)

    def load(self, frames: Frames) -> None:
        """Take frames over. Raises ConfigError where they do not fit."""
        self._frames = None
        for view in (self._bench.panels.projector, self._bench.panels.mask):
            check_fit(frames, view)
        self._frames = frames

    def black(self) -> None:
        """Both black."""
        now_ns = self._clock.now_ns()
        for side in (0, 1):
            self._bench.send(side, now_ns, None, BLACK)

    def show(self, frames: Frames) -> None:
        """Hold the first row."""
        self.load(frames)
        for side in (0, 1):
            self._bench.send(side, self._clock.now_ns(), frames, 0)

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show all frames, refresh by refresh."""
        frames, config, bench = self._frames, self._config, self._bench
        if frames is None:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")

        def once(rows: NDArray[np.int32]) -> FrameLog:
            primal, dual = streams(rows, config.display.mask_delay_refreshes)
            count = len(primal)
            first = self._clock.now_ns() // 16_666_667 + 1
            at = np.rint((first + np.arange(count + 1)) * (1e9 / REFRESH_HZ)).astype(np.int64)
            for number, at_ns in enumerate(at[:-1].tolist()):
                self._clock.sleep_until_ns(at_ns)
                bench.send(0, at_ns, frames, int(primal[number]))
                bench.send(1, at_ns, frames, int(dual[number]))
                if number % 5 == 0:
                    progress(number, count, 0)
                    if cancelled():
                        self.black()
                        raise Cancelled("cancelled", device="display")
            self._clock.sleep_until_ns(int(at[-1]))
            for side in (0, 1):
                bench.send(side, int(at[-1]), None, BLACK)
            progress(count, count, 0)
            none = np.zeros(count, dtype=np.int32)
            return FrameLog(primal, dual, at[:-1], at[:-1].copy(), at[[-1, -1]], none, "foreign",
                            True, primal, dual, config.display.mask_delay_refreshes)  # fmt: skip

        rig = config.rig
        return play_all(once, frames, on_miss=rig.on_miss, rounds=rig.retries, row_hz=REFRESH_HZ)

    def disconnect(self) -> None:
        """Black."""
        self.black()
        self._frames = None


class Blades:
    """A shutter that obeys late."""

    maturity = "experimental"

    def __init__(self, context: DriverContext) -> None:
        self._bench, self._clock = Bench.of(context), context.clock
        self._sure_ns = context.config.trigger.sure_ns
        self._rng = np.random.default_rng([self._bench.facts.seed, 10])

    @classmethod
    def create(cls, context: DriverContext) -> Blades:
        """The shutter of a rig. Raises ConfigError."""
        return cls(context)

    def connect(self) -> dict[str, str]:
        """Closed."""
        self.close()
        return {"model": "foreign blades"}

    def open(self) -> int:
        """It opens within what the configuration allows for."""
        asked_ns = self._clock.now_ns()
        self._bench.forget(asked_ns)
        self._bench.open_ns, self._bench.closed_ns = asked_ns + self._late_ns(), None
        return self._surely(asked_ns)

    def close(self) -> int:
        """It closes as late, or later where the judge wants a longer exposure."""
        asked_ns, bench = self._clock.now_ns(), self._bench
        if bench.open_ns is None or bench.closed_ns is not None:
            return asked_ns
        stretch = bench.look().stretch
        if stretch > 1.0:
            asked_ns = bench.open_ns + round((asked_ns - bench.open_ns) * stretch)
            self._clock.sleep_until_ns(asked_ns)
        bench.closed_ns = asked_ns + self._late_ns()
        return self._surely(asked_ns)

    def disconnect(self) -> None:
        """Closed."""
        self.close()

    def _surely(self, asked_ns: int) -> int:
        sure_ns = asked_ns + self._sure_ns
        self._clock.sleep_until_ns(sure_ns)
        return sure_ns

    def _late_ns(self) -> int:
        facts = self._bench.facts
        wobble = float(np.clip(self._rng.standard_normal(), -3.0, 3.0))
        return round((facts.lag_s + facts.jitter_s * wobble) * 1e9)


class Camera:
    """A Bayer camera with a ring of stops that are not quite what is engraved."""

    maturity = "experimental"

    def __init__(self, context: DriverContext) -> None:
        self._bench, self._config = Bench.of(context), context.config.camera
        self._clock: Clock = context.clock
        self._settings: CameraSettings | None = None

    @classmethod
    def create(cls, context: DriverContext) -> Camera:
        """The camera of a rig. Raises ConfigError."""
        return cls(context)

    def connect(self) -> CameraInfo:
        """What it is."""
        facts = self._bench.facts
        return CameraInfo(
            model=f"Foreign {facts.camera}",
            serial=f"{facts.seed:04d}",
            profile=self._config.profile,
            responsivity_e=responsivity_e(self._config),
            isos=(100,),
            f_numbers=ENGRAVED,
            frame_quads=CAMERAS[facts.camera][0],
            readout_s=0.3,
        )

    def arm(self, settings: CameraSettings) -> None:
        """Set the ring. Raises ConfigError for a stop that is not on it."""
        if settings.iso != 100 or settings.f_number not in ENGRAVED:
            raise ConfigError(
                f"no ISO {settings.iso} at f/{settings.f_number}", device="camera",
                hint="ISO 100 and f/" + ", f/".join(f"{stop:g}" for stop in ENGRAVED),
            )  # fmt: skip
        self._settings = settings

    def fetch(self, folder: Path, name: str, timeout_s: float) -> RawFile:
        """The photo of the last exposure."""
        bench, settings, self._settings = self._bench, self._settings, None
        if settings is None or settings.f_number is None:
            raise ExposureError("the camera was not armed", device="camera", hint="call arm first")
        if bench.open_ns is None or bench.closed_ns is None:
            raise ExposureError("there is no photo", device="camera", hint="open and close")
        exposure_s = (bench.closed_ns - bench.open_ns) * 1e-9
        world = bench.world
        true_f = bench.facts.stops[ENGRAVED.index(settings.f_number)]
        samples = world.take(bench.shown(), 0.0, exposure_s, true_f, bench.room(), bench.rng)
        bench.open_ns = bench.closed_ns = None
        self._clock.sleep_until_ns(self._clock.now_ns() + 300_000_000)
        _, _, black, white, *_ = CAMERAS[bench.facts.camera]
        says_s = bench.stands.says_s
        return write_dng(
            folder / f"{name}.dng", samples, black=black, white=white, iso=100,
            exposure_s=exposure_s if says_s is None else says_s, f_number=settings.f_number,
            model=f"Foreign {bench.facts.camera}", serial=f"{bench.facts.seed:04d}",
        )  # fmt: skip

    def disconnect(self) -> None:
        """Forget the settings."""
        self._settings = None


def _conforms(context: DriverContext) -> tuple[Display, Shutter, Readout]:
    """Let a type checker compare the classes with their Protocols."""
    return Panels.create(context), Blades.create(context), Camera.create(context)
