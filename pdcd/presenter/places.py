"""Where both panels lie on the X screen, checked at the start and watched from then on."""

from __future__ import annotations

from typing import Any

from pdcd.errors import DeviceLost
from pdcd.presenter import desktop
from pdcd.presenter.messages import Open, Rect
from pdcd.presenter.outputs import (
    Output,
    OutputPair,
    Watcher,
    check_nominal,
    find_pair,
    place_pair,
    read_outputs,
)
from pdcd.presenter.xconnection import guard_x_calls, open_x_connection


class Places:
    """Both panels' places, and whether they still hold.

    Raises ConfigError when the outputs are not what is asked for or something else draws on the
    screen, DeviceLost when the server or an output is not there.
    """

    def __init__(self, name: str | None, request: Open) -> None:
        self._request = request
        self._display: Any = open_x_connection(name)
        self.name = str(self._display.get_display_name())
        desktop.check_desktop(self._display)
        self._pair = self._find()
        rates_hz = request.projector.refresh_hz, request.mask.refresh_hz
        check_nominal(self._pair, projector_hz=rates_hz[0], mask_hz=rates_hz[1])
        screen = self._display.screen()
        with guard_x_calls(self._display):
            self.screen_px = (int(screen.width_in_pixels), int(screen.height_in_pixels))
            # The screen's own black: what shows when this process, and its windows, are gone.
            screen.root.change_attributes(background_pixel=screen.black_pixel)
            screen.root.clear_area()
            self._display.sync()
        self._watcher = Watcher(open_x_connection(name))
        self._moved = False

    @property
    def outputs(self) -> tuple[Output, Output]:
        """Outputs of projector and mask."""
        return self._pair.projector, self._pair.mask

    @property
    def panels(self) -> tuple[Rect, Rect]:
        """Projector and mask."""
        return _rect(self._pair.projector), _rect(self._pair.mask)

    @property
    def identity(self) -> dict[str, str]:
        """What the outputs say of themselves, and how fast they slip."""
        pair = self._pair
        found = {"projector": str(pair.projector), "mask": str(pair.mask)}
        if pair.refresh_hz is not None:
            slip_s = pair.slip_s
            found["slip"] = "none" if slip_s is None else f"one refresh in {slip_s:.1f} s"
        return found

    @property
    def drifts(self) -> bool:
        """Whether the modes have different rates, so that no phase lasts."""
        return self._pair.projector.refresh_hz != self._pair.mask.refresh_hz

    def fileno(self) -> int:
        """What is readable where `changed` has something to look at."""
        return self._watcher.fileno()

    def changed(self) -> bool:
        """Whether outputs changed since the start; `check_desktop` says what to make of it."""
        self._moved = self._watcher.changed() or self._moved
        return self._moved

    def check(self) -> None:
        """Raise DeviceLost when the outputs are no longer those of the start."""
        if not self.changed():
            return
        self._moved = False
        now = self._find()
        if now != self._pair:
            raise DeviceLost(
                f"the outputs have changed: {self._pair.projector}; {self._pair.mask} "
                f"became {now.projector}; {now.mask}",
                device="display",
                hint="restore the modes; the next job opens the panels anew",
            )

    def _find(self) -> OutputPair:
        options = self._request.options
        projector = (options.projector, self._request.projector.size_px)
        mask = (options.mask, self._request.mask.size_px)
        outputs = read_outputs(self._display)
        if options.positions_px is None:
            return find_pair(outputs, projector=projector, mask=mask)
        return place_pair(
            outputs, projector=projector, mask=mask, positions_px=options.positions_px
        )


def _rect(output: Output) -> Rect:
    return Rect(output.x, output.y, output.width, output.height)
