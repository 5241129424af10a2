"""Projector and mask on one controller of Acme's, which shows a pair of pictures at a time."""

from __future__ import annotations

from collections.abc import Callable

import acme
import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.driver import (
    BLACK,
    Cancelled,
    ConfigError,
    DeviceLost,
    Display,
    DisplayInfo,
    DriverContext,
    FrameLog,
    Frames,
    check_fit,
    check_row_times,
    draw,
    panels_of,
    play_all,
    read_options,
    streams,
)


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[display.options] of this driver."""

    serial: str


class AcmePanels:
    """Hands the controller the next pair of pictures as soon as the one before is shown."""

    maturity = "experimental"

    def __init__(self, options: Options, context: DriverContext) -> None:
        self._options, self._config = options, context.config
        self._clock, self._alive = context.clock, context.alive
        self._views = panels_of(context.config)
        self._device: acme.Panels | None = None
        self._frames: Frames | None = None

    @classmethod
    def create(cls, context: DriverContext) -> AcmePanels:
        """Check the options; the controller is opened by `connect`. Raises ConfigError."""
        options = read_options(
            context.config.display.options,
            Options,
            table="display.options",
            device="display",
            hint="serial is the option of the driver acme-panels",
        )
        return cls(options, context)

    def connect(self) -> DisplayInfo:
        """Open the controller; both panels are black on return. Raises DeviceLost."""
        self.disconnect()
        try:
            self._device = acme.open_panels(self._options.serial)
        except OSError as err:
            raise DeviceLost(
                f"no panels {self._options.serial}", device="display", hint="are they plugged in?"
            ) from err
        self.black()
        projector, mask = self._device.sizes_px
        identity = {"projector": "Acme", "mask": "Acme"}
        # The lag of the mask's light is not known until it is measured: pdcd calibrate timing.
        return DisplayInfo(projector, mask, self._device.refresh_hz, identity, mask_lag_s=None)

    def load(self, frames: Frames) -> None:
        """Accept what `play` is to show. Raises ConfigError for what the panels cannot show."""
        self._frames = None
        check_row_times(frames)
        check_fit(frames, self._views.projector)
        check_fit(frames, self._views.mask)
        self._frames = frames
        self.black()

    def show(self, frames: Frames) -> None:
        """Show the first row until `black` or `play`."""
        self.load(frames)
        self._present(frames, 0, 0)

    def black(self) -> None:
        """Make both panels black. Safe in every state, and beside every other call."""
        if self._device is not None:
            self._device.show_black()

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show all rows; both panels are black on return, however it ends."""
        device, frames, rig = self._device, self._frames, self._config.rig
        if device is None or frames is None:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")
        refresh_hz = device.refresh_hz

        def once(rows: NDArray[np.int32]) -> FrameLog:
            delay = self._config.display.mask_delay_refreshes
            projector, mask = streams(rows, delay)
            begun_ns, late = list[int](), list[int]()
            for number, pair in enumerate(zip(projector, mask, strict=True)):
                if number % max(1, round(refresh_hz / 10.0)) == 0:
                    self._alive()
                    progress(number, len(projector), sum(late))
                    if cancelled():
                        raise Cancelled("cancelled", device="display")
                self._present(frames, *pair)
                begun_ns.append(self._clock.now_ns())
                waited_s = 1e-9 * (begun_ns[-1] - begun_ns[-2]) if number else 0.0
                late.append(max(round(waited_s * refresh_hz) - 1, 0))
            self._present(frames, BLACK, BLACK)  # the last row is seen until then
            end_ns = self._clock.now_ns()
            progress(len(projector), len(projector), sum(late))
            shown_ns = np.array(begun_ns, np.int64)
            # These are the times at which calls returned. Say verified=True only if the device
            # itself tells when each picture was seen.
            return FrameLog(
                projector, mask, shown_ns, shown_ns.copy(), np.array([end_ns, end_ns]),
                np.array(late, np.int32), "acme", verified=False,
                primal_asked=projector, dual_asked=mask, mask_delay=delay,
            )  # fmt: skip

        try:
            return play_all(
                once, frames, on_miss=rig.on_miss, rounds=rig.retries, row_hz=refresh_hz
            )
        finally:
            self.black()

    def disconnect(self) -> None:
        """Black, and let the controller go."""
        self.black()
        device, self._device, self._frames = self._device, None, None
        if device is not None:
            device.close()

    def _present(self, frames: Frames, projector: int, mask: int) -> None:
        """Show a row on either panel, `BLACK` for none; returns when both are seen."""
        if self._device is None:
            raise DeviceLost("the panels are not open", device="display", hint="connect them first")
        views = self._views.projector, self._views.mask
        pictures = [
            draw(frames, view, int(row)) for view, row in zip(views, (projector, mask), strict=True)
        ]
        try:
            self._device.show(*pictures)
        except OSError as err:
            raise DeviceLost("the panels do not answer", device="display", hint="cable?") from err


_: type[Display] = AcmePanels  # a type checker compares it with what is promised
