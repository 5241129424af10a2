"""What the mock drivers share: the scene, and what it was shown while the shutter was open.

Modelled: both panels' own refresh and phase, first-order response, black leak, skew, jitter and
misregistration; sub-cell windows; ambient light; shutter lag and jitter. A bench with placed
devices or a truth is computed by pixels (`pdcd.virtual.optics`): this adds maps, blur, falloff,
scan-out, dead lines, gamma. So is an exposure in which a camera with several quads a cell sees the
edges of windows. Not modelled: projector colour wheels and dithering, motion. Panels are assumed to
have settled to black when the shutter opens; if they had less time for it than `rig.settle_s`,
there is no photo, unless patterns are of pixels and the rig moves the shutter on purpose
(`SharedState.moving`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.devices import SharedState
from pdcd.bench.placed import compute_mock_frame
from pdcd.bench.truth import BenchTruth, load_bench_truth, restore_typed_values
from pdcd.driver import Config, ConfigError, DriverContext, ExposureError, FrameLog, Frames
from pdcd.panels.frames import invert_mask_patterns
from pdcd.probing.pixel_matrix import compute_pixel_factors
from pdcd.probing.realised import compute_bench_factors
from pdcd.virtual.optics.needed import build_pixel_bench, choose_optics
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.scene import Scene

if TYPE_CHECKING:
    from pdcd.virtual.optics.bench import OpticalBench


_SECOND_NS = 1_000_000_000
_OF_EXPOSURES = ("open_ns", "close_ns", "unsettled")
"""Fields that a live view leaves unchanged."""


class WatchedPanels(Protocol):
    """Panels in front of the bench that are not the mock's own but report what they showed."""

    def expose(self, *, active: bool, at_ns: int) -> None:
        """Set the camera's line, which says that the shutter is open, or closed, from then on."""
        ...

    def show_between(self, open_ns: int, close_ns: int) -> tuple[Frames, FrameLog]:
        """What both showed, including rows that began before the opening."""
        ...

    def find_standing(self) -> Frames | None:
        """What both show now, in one row; None is black."""
        ...

    def count_pulses(self, side: int, low_ns: int, high_ns: int) -> int:
        """Number of pulses that began at the output of projector or mask, from `low_ns` on and
        before `high_ns`."""
        ...


@dataclass
class MockBench:
    """One virtual bench. The drivers set its fields; `photo` reads them."""

    config: Config
    scene: Scene
    frames: Frames | None = None
    log: FrameLog | None = None
    open_ns: int | None = None
    close_ns: int | None = None
    black_since_ns: int | None = -(2**62)
    """When the panels last went black, initially long ago; None while they show something."""
    exposures: int = 0
    """How many times the shutter was opened."""
    whole: bool = False
    """Whether all codes of this exposure were shown; if not, it gives no photo in any case."""
    unsettled: str = ""
    """How the shutter of this exposure moved before the panels had settled; '' if it did not."""
    shutter_open: bool = field(default=False)
    second: bool = False
    """Whether the second bucket of the sensor is read (`pdcd.panels.frames`)."""
    shared: SharedState = field(default_factory=SharedState)
    panels: WatchedPanels | None = None
    """The panels, if they are not the mock's own but report what they showed."""
    _held: tuple[Frames | None, NDArray[np.float64]] | None = field(default=None, repr=False)
    """What a display last held for a live view, and its light."""

    @classmethod
    def of(cls, context: DriverContext) -> MockBench:
        """The bench of this rig; made by the first driver that asks."""

        def make() -> MockBench:
            scene = context.shared.scene = build_scene(context.config.scene)
            return cls(context.config, scene, shared=context.shared)

        return context.the(cls, make)

    def lit(self) -> None:
        """The panels show something from now on."""
        self.black_since_ns = None

    def black(self, at_ns: int) -> None:
        """Both panels are black from then on; further calls do not restart their settling."""
        if self.black_since_ns is None:
            self.black_since_ns = at_ns

    def _check_settled(self, word: str, at_ns: int) -> None:
        """Note a shutter that moves too soon. It moves all the same: closing may never fail."""
        since_ns, settle_ns = self.black_since_ns, round(self.config.rig.settle_s * 1e9)
        if since_ns is None or at_ns < since_ns + settle_ns:
            self.unsettled = self.unsettled or f"the shutter {word} on panels that had not settled"

    def open_shutter(self, open_ns: int) -> None:
        """Light falls on the sensor from then on; what was shown before does not count."""
        self.unsettled, self.whole = "", False
        self.exposures += 1
        self._check_settled("opened", open_ns)
        self.open_ns, self.close_ns = open_ns, None
        self.frames = self.log = None
        self.shared.played = self.shared.pixels = None
        self.shutter_open = True
        if self.panels is not None:
            self.panels.expose(active=True, at_ns=open_ns)

    def close_shutter(self, close_ns: int) -> None:
        """The exposure ends then."""
        if self.whole:
            self._check_settled("closed", close_ns)
        self.close_ns = close_ns
        self.shutter_open = False
        if self.panels is not None:
            self.panels.expose(active=False, at_ns=close_ns)

    def exposed_ns(self) -> tuple[int, int]:
        """When the last exposure began and ended, by the bench's own shutter or another driver's.

        For another driver's shutter only the rig knows these times, as those when it was surely
        open and surely closed; panels are black around them.

        Raises ExposureError when no exposure has been completed, or its photo was taken already.
        """
        found = self.shared.exposed_ns
        if self.open_ns is not None:
            found = None if self.close_ns is None else (self.open_ns, self.close_ns)
        if found is None:
            raise ExposureError(
                "there is no finished exposure", device="camera", hint="open and close the shutter"
            )
        return found

    def photo_taken(self) -> None:
        """The exposure is read out: there is nothing more on the sensor."""
        self.open_ns = self.close_ns = self.shared.exposed_ns = None

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of code cells."""
        return self.config.code_grid(self.scene.grid)

    @property
    def frame(self) -> tuple[int, int]:
        """Rows and columns of the camera's quads."""
        return compute_mock_frame(self.config, self.grid)

    @cached_property
    def optics(self) -> OpticalBench | None:
        """The bench pixel by pixel; None if computing it by cells is exact.

        It is made when the bench is photographed; with a real camera it is not needed. Raises
        ConfigError for a truth or a map that cannot be used.
        """
        return choose_optics(self.config, self.scene)

    @cached_property
    def truth(self) -> BenchTruth:
        """How the bench differs from its configuration. Raises ConfigError."""
        return load_bench_truth(self.config)

    @cached_property
    def true(self) -> Config:
        """The configuration that describes the bench as it is. Raises ConfigError."""
        return self.truth.of(self.config)

    @cached_property
    def typed(self) -> Config:
        """The configuration with the devices as they were before anything was measured."""
        return restore_typed_values(self.config)

    def held_light(self) -> NDArray[np.float64]:
        """Light at the camera's quads while the display holds black or a picture, (rows, cols, 3)
        float64 in scene units; computed once for each picture."""
        held = self.shared.held if self.panels is None else self.panels.find_standing()
        if self._held is None or self._held[0] is not held:
            kept = {name: getattr(self, name) for name in _OF_EXPOSURES}
            frames, log = (held, _hold()) if held else _nothing(self.grid, 0)
            self.open_ns, self.close_ns, self.unsettled = 0, _SECOND_NS, ""
            try:
                self._held = held, self._exposed_quads(self._to_bucket(frames), log)
            finally:
                vars(self).update(kept)
        return self._held[1]

    def quads(self) -> NDArray[np.float64]:
        """Light of the last exposure at the camera's quads, (rows, cols, 3) float64 in scene units
        times seconds. Raises ExposureError as `photo` does."""
        if self.shared.held is not None and self.panels is None:
            open_ns, close_ns = self.exposed_ns()
            return self.held_light() * ((close_ns - open_ns) * 1e-9)
        return self._exposed_quads(*self._played())

    def _exposed_quads(self, frames: Frames, log: FrameLog) -> NDArray[np.float64]:
        open_ns, close_ns = self.exposed_ns()
        if not (self.shared.moving and frames.of_pixels):
            self._check_photo()
        optics = self.optics or self._finer_optics(frames)
        if optics is None:
            per_cell = self.config.camera.quads_per_cell
            cells = self._photo(frames, log).reshape(*self.grid, 3)
            return cells.repeat(per_cell, axis=0).repeat(per_cell, axis=1)
        if self.shared.pixels is not None:
            raise ExposureError(
                "a bench of pixels cannot have a display that reads its own pixels (grab_px)",
                device="camera",
                hint="remove grab_px from display.options, or the truth and places of the bench, "
                "and leave one quad a cell",
            )
        from pdcd.virtual.optics.products import PanelExposure

        exposure = PanelExposure(
            frames,
            log,
            open_ns,
            close_ns,
            covered=self.shared.covered,
            lights_off=self.exposures < self.truth.scene.ambient_from,
        )
        start_ns = _find_start_ns(log, open_ns)
        if start_ns == open_ns:
            return optics.photo(exposure)
        whole, before = (
            optics.photo(replace(exposure, open_ns=start_ns, close_ns=end_ns))
            for end_ns in (close_ns, open_ns)
        )
        return np.maximum(whole - before, 0.0)

    def _finer_optics(self, frames: Frames) -> OpticalBench | None:
        """The bench pixel by pixel if only these frames need it: for windows that cut cells or
        pixels, and for patterns of the panels' own pixels."""
        coded = len(frames.primal_patterns) or len(frames.dual_patterns)
        if frames.of_pixels or (coded and self._needs_pixels(frames.window)):
            return self._optics_of_pixels
        return None

    def _needs_pixels(self, window: str) -> bool:
        return choose_optics(self.config, self.scene, (window,)) is not None

    @cached_property
    def _optics_of_pixels(self) -> OpticalBench:
        return build_pixel_bench(self.config, self.scene)

    def photo(self) -> NDArray[np.float64]:
        """Light of the last exposure on cells, (N, 3) float64 in scene units times seconds; for a
        bench without `optics`.

        Raises ExposureError when no exposure has been completed, or its shutter moved before the
        panels had settled to black.
        """
        self._check_photo()
        return self._photo(*self._played())

    def _photo(self, frames: Frames, log: FrameLog) -> NDArray[np.float64]:
        open_ns, close_ns = self.exposed_ns()
        start_ns = _find_start_ns(log, open_ns)
        light = self._cell_light(frames, log, start_ns, close_ns)
        if start_ns < open_ns:
            light -= self._cell_light(frames, log, start_ns, open_ns)
        return light

    def _cell_light(
        self, frames: Frames, log: FrameLog, open_ns: int, close_ns: int
    ) -> NDArray[np.float64]:
        projector, mask = self.true.projector, self.true.mask
        light = np.zeros((self.scene.cells, 3))
        shown = self.shared.pixels
        if shown is None:
            parts = compute_bench_factors(
                frames,
                log,
                projector,
                mask,
                open_ns=open_ns,
                close_ns=close_ns,
                displacement=self.scene.displacement,
            )
        else:  # the display has read its own pixels: they count, not the request
            parts = compute_pixel_factors(
                shown,
                log,
                projector,
                mask,
                grid=self.scene.grid,
                open_ns=open_ns,
                close_ns=close_ns,
            )
        for part in parts:
            light += self.scene.photo(
                part.left, part.right, part.coaxial, part.open_s, part.displaced
            )
        return light

    def _check_photo(self) -> None:
        if self.unsettled:
            raise ExposureError(
                self.unsettled, device="shutter", hint="wait for rig.settle_s on black panels"
            )

    def _played(self) -> tuple[Frames, FrameLog]:
        """What the panels showed in the last exposure, to the bucket that is read."""
        if self.panels is not None:
            frames, log = self.panels.show_between(*self.exposed_ns())
        elif self.frames is None or self.log is None:  # not the mock's display: the rig knows
            frames, log = self.shared.played or _nothing(self.grid, self.exposed_ns()[0])
        else:
            frames, log = self.frames, self.log
        return self._to_bucket(frames), log

    def _to_bucket(self, frames: Frames) -> Frames:
        """The frames as seen by the bucket that is read."""
        return invert_mask_patterns(frames) if self.second else frames


def _find_start_ns(log: FrameLog, open_ns: int) -> int:
    """When panels were last black: at the opening, or before their first row if that began earlier.
    The exposure's light is all light since then less the light before the opening."""
    firsts = (int(starts[0]) for starts in (log.primal_ns, log.dual_ns) if starts.size)
    return min(open_ns, *firsts) if len(log) else open_ns


def _hold() -> FrameLog:
    """The log of panels that show the first refresh for a second."""
    first, at = np.zeros(1, dtype=np.int32), np.zeros(1, dtype=np.int64)
    return FrameLog(first, first, at, at, np.array([_SECOND_NS, _SECOND_NS]), first, "held", True)


def _nothing(grid: tuple[int, int], at_ns: int) -> tuple[Frames, FrameLog]:
    """Frames and log of panels that stayed black."""
    empty, none = np.zeros((0, 0), dtype=np.uint8), np.zeros(0, dtype=np.int32)
    frames = Frames(
        empty, empty, none, none, none.astype(np.uint8), none, none.astype(np.bool_),
        grid, grid, "whole",
    )  # fmt: skip
    stamps = np.zeros(0, dtype=np.int64)
    log = FrameLog(none, none, stamps, stamps, np.array([at_ns, at_ns]), none, "none", True)
    return frames, log


def check_no_options(options: Mapping[str, Any], table: str, device: str) -> None:
    """Raise ConfigError if there are any options: they are for another driver, and would be
    ignored."""
    if options:
        raise ConfigError(
            f"[{table}] {', '.join(options)}: the driver mock has no options",
            device=device,
            hint="name the driver that they belong to, or remove them",
        )
