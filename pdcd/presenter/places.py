"""Where both panels lie on the X screen: checked at the start and watched afterwards."""

from __future__ import annotations

from typing import Any

from pdcd.bench.devices import Finding
from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter import desktop
from pdcd.presenter.levels import list_level_findings
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

    Raises ConfigError when the outputs are not those asked for, do not show what is drawn, or
    something else draws on the screen; DeviceLost when the server or an output is not there.
    """

    def __init__(self, name: str | None, request: Open) -> None:
        self._request = request
        self._display: Any = open_x_connection(name)
        self.name = str(self._display.get_display_name())
        desktop.check_desktop(self._display)
        self._pair = self._find()
        rates_hz = request.projector.refresh_hz, request.mask.refresh_hz
        check_nominal(self._pair, projector_hz=rates_hz[0], mask_hz=rates_hz[1])
        self._refuse_levels(self._pair)
        screen = self._display.screen()
        with guard_x_calls(self._display):
            self.screen_px = (int(screen.width_in_pixels), int(screen.height_in_pixels))
            # The screen's own black, which shows when this process and its windows are gone.
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
        """Places of projector and mask."""
        return _rect(self._pair.projector), _rect(self._pair.mask)

    @property
    def identity(self) -> dict[str, str]:
        """Descriptions of the outputs, and how fast they slip."""
        pair = self._pair
        found = {"projector": str(pair.projector), "mask": str(pair.mask)}
        if pair.refresh_hz is not None:
            slip_s = pair.slip_s
            found["slip"] = "none" if slip_s is None else f"one refresh in {slip_s:.1f} s"
        return found

    @property
    def warnings(self) -> tuple[str, ...]:
        """What outputs do to levels without spoiling black and white codes, and how to mend it."""
        found = (f for f in self._levels(self._pair) if f.state == "warning")
        return tuple(f"{f.what}: {f.found}: {f.hint}" for f in found)

    @property
    def drifts(self) -> bool:
        """Whether the modes have different rates, so that the phase drifts."""
        return self._pair.projector.refresh_hz != self._pair.mask.refresh_hz

    def fileno(self) -> int:
        """File descriptor that is readable when `changed` has something to look at."""
        return self._watcher.fileno()

    def changed(self) -> bool:
        """Whether outputs have reported a change; `check` finds out whether it matters."""
        self._moved = self._watcher.changed() or self._moved
        return self._moved

    def check(self, *, unheard: bool = False) -> None:
        """Raise DeviceLost when the outputs are no longer those of the start, ConfigError when they
        no longer show what is drawn.

        unheard : look even if the server reported no change: it does not report gamma ramps.
        """
        heard = self.changed()
        if not (heard or unheard):
            return
        self._moved = False
        now = self._find(anew=heard)
        if now != self._pair:
            self._refuse_levels(now)
            raise DeviceLost(
                f"the outputs have changed: {self._describe(self._pair, now)} "
                f"became {self._describe(now, self._pair)}",
                device="display",
                hint="restore the modes; the next job opens the panels again",
            )

    def _levels(self, pair: OutputPair) -> list[Finding]:
        exact = self._request.plane_order is not None
        return [
            finding
            for role, output in (("projector", pair.projector), ("mask", pair.mask))
            for finding in list_level_findings(output.name, role, output.levels, exact=exact)
        ]

    def _refuse_levels(self, pair: OutputPair) -> None:
        """Raise ConfigError if black and white do not come out as they are drawn."""
        for found in self._levels(pair):
            if found.state == "fault":
                raise ConfigError(f"{found.what}: {found.found}", device="display", hint=found.hint)

    def _describe(self, pair: OutputPair, other: OutputPair) -> str:
        """Both outputs in words; their levels, if only these differ from `other`."""
        words = [str(pair.projector), str(pair.mask)]
        if words == [str(other.projector), str(other.mask)]:
            words = [f"{found.what} {found.found}" for found in self._levels(pair)]
        return "; ".join(words)

    def _find(self, *, anew: bool = True) -> OutputPair:
        options = self._request.options
        projector = (options.projector, self._request.projector.size_px)
        mask = (options.mask, self._request.mask.size_px)
        outputs = read_outputs(self._display, anew=anew)
        if options.positions_px is None:
            return find_pair(outputs, projector=projector, mask=mask)
        return place_pair(
            outputs, projector=projector, mask=mask, positions_px=options.positions_px
        )


def _rect(output: Output) -> Rect:
    return Rect(output.x, output.y, output.width, output.height)
