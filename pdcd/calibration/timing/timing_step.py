"""When light really comes: whole refreshes of delay first, then lag by row, rise and fall."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.figures import ROOM_GOOD, MeasuredFigure, Verdict, describe_room_light
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    ConfigValue,
    PhotoRequest,
    StepOutcome,
    StepScript,
    UserPrompt,
    take_photo,
)
from pdcd.calibration.timing.delayed import shift_mask, undo_mask_shift
from pdcd.calibration.timing.lag import MeasuredTiming, find_coarse_delay, fit_timing
from pdcd.calibration.timing.programmes import (
    COARSE,
    PulseStrips,
    make_pulse_strips,
    make_room_sequence,
    make_strip_sequence,
)
from pdcd.calibration.timing.strips import StripReadings, read_strips
from pdcd.calibration.timing.timing_faults import measure_room_light
from pdcd.calibration.timing.timing_model import TAUS, PhotoLog
from pdcd.calibration.timing.timing_picture import draw_timing
from pdcd.calibration.window import Window, find_shared_window
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map
from pdcd.panels.schedule import SLOTS

_PERIOD = 24
"""Refreshes of the longest programme: all photos last a whole number of these."""
_FULLER = 1.1
"""Refreshes of a photo, at most, over `CalibrationSession.full`."""
_TRAIL = 13
"""Black refreshes at the end: a mask that is many refreshes late still shows what it was sent."""
_BANDS = 3, 12
_QUADS_A_BAND = 40
"""Rows of quads that a band has, at least."""
_PERMUTATIONS, _MOST_PERMUTATIONS = 4, 16
"""Photos of fine strips; up to the second number where the noise of four leaves times uncertain, as
with a sensor with small pixels and fast panels."""
_NEAR = 1
"""Refreshes by which the delay may still be wrong at a second coarse search."""
_FLAT_S = 1e-4
"""Lag from top to bottom below which, if it is also below three sigmas, it counts as the same
everywhere."""
_NO_SCAN_S = 1e-5
"""Lag from top to bottom below which it always counts as the same everywhere: strips cannot be read
more accurately."""
_STEP_S = 2.5e-4
"""Lag from one band of rows to the next, in the configuration."""
_MOST_BANDS = 128
_AGAINST = 0.3
"""Lag from top to bottom, in refreshes, from which the mounting of the panels matters."""
_ONE_PANEL = 1.05
"""The lag from which both panels must be set row by row, in opposite directions: one alone takes a
refresh at most."""
_SETTLED = 5.0
"""Time constants after which a panel counts as black."""
_LEAKS = 0.12, 1.0
"""Light of a code in others under the best schedule from which the bench is doubtful, and bad."""


@dataclass(frozen=True, eq=False)
class _Rig:
    """What is needed to make and read photos of strips."""

    projector: Map
    mask: Map
    camera: Map
    refreshes: int
    bands: int
    window: Window

    @classmethod
    def of(cls, session: CalibrationSession) -> _Rig:
        projector, mask, camera = (session.found(n) for n in ("projector", "mask", "camera"))
        periods = max(2, int(_FULLER * session.full) // _PERIOD)
        bands = int(np.clip(camera.size_px[1] // _QUADS_A_BAND, *_BANDS))
        return cls(
            projector, mask, camera, periods * _PERIOD, bands, find_shared_window(mask, camera)
        )

    def wanted(
        self, name: str, strips: PulseStrips, delay: int, *, white: bool = False
    ) -> PhotoRequest:
        """A photo of strips, with the mask sent its pictures `delay` refreshes later."""
        periods = self.refreshes // strips.programmes[0].of
        shown = make_strip_sequence(
            name, strips, self.projector, self.mask, white=white, periods=periods
        )
        return PhotoRequest(shift_mask(shown, delay, _TRAIL))

    def room(self, strips: PulseStrips, delay: int) -> PhotoRequest:
        """The white photo of strips again, with a black projector."""
        white = self.wanted("white", strips, delay, white=True)
        return replace(white, shown=make_room_sequence(white.shown))

    def read(
        self, photo: QuadPhoto, white: QuadPhoto, strips: PulseStrips, room: QuadPhoto | None = None
    ) -> StripReadings:
        return read_strips(photo, white, self.camera, strips, bands=self.bands, room=room)


def calibrate_timing(session: CalibrationSession) -> StepScript:
    """White, coarse strips, white without the projector, fine strips four times: seven photos; nine
    where the mask is whole refreshes late, or early; up to twelve more where four are too noisy.

    Raises CalibrationError as `find_coarse_delay`, `read_strips` and `fit_timing` do.
    """
    rig = _Rig.of(session)
    delay, white = yield from _coarse(session, rig)
    readings: list[StripReadings] = []
    ran: list[PhotoLog] = []
    rows_delay = 0
    taken = yield from take_photo(
        rig.room(make_pulse_strips(rig.projector, window=rig.window), delay)
    )
    room = session.photo(taken)
    count = _PERMUTATIONS
    while True:
        for number in range(len(readings), count):
            strips = make_pulse_strips(rig.projector, number, window=rig.window)
            taken = yield from take_photo(rig.wanted(f"rhythms-{number + 1}", strips, delay))
            readings.append(rig.read(session.photo(taken), white, strips, room))
            measure_room_light(readings[-1])
            ran.append(undo_mask_shift(taken.ran, delay, rig.refreshes))
            rows_delay = taken.log.mask_delay
        found = fit_timing(readings, ran, session.refresh_s)
        times = found.noise_over_limit**2
        if times <= 1.0 or count == _MOST_PERMUTATIONS:
            break
        count = 2 * ceil(0.5 * min(times * count, _MOST_PERMUTATIONS))
    return _outcome(session, rig, found, readings, rows_delay + delay)


def _coarse(
    session: CalibrationSession, rig: _Rig
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, tuple[int, QuadPhoto]]:
    """By how many refreshes later the mask should be sent its pictures, and the white photo of
    strips with that delay."""
    strips, delay = make_pulse_strips(rig.projector, 0, tuple(COARSE), rig.window), 0
    for number in ("", "-again"):
        taken = yield from take_photo(rig.wanted(f"white{number}", strips, delay, white=True))
        white = session.photo(taken)
        taken = yield from take_photo(rig.wanted(f"coarse{number}", strips, delay))
        more = find_coarse_delay(rig.read(session.photo(taken), white, strips))
        if abs(more) <= _NEAR * bool(number):
            return delay, white
        if number:
            raise CalibrationError(
                f"the mask was {-delay} refreshes late; with these taken out, it is {-more} "
                "refreshes late",
                device="display",
                hint="the delay between the panels changes from photo to photo: switch off frame "
                "interpolation and variable refresh rates, and start both outputs together",
            )
        delay = more
    raise AssertionError("two rounds end the search")


def _outcome(
    session: CalibrationSession,
    rig: _Rig,
    found: MeasuredTiming,
    readings: list[StripReadings],
    rows_delay: int,
) -> StepOutcome:
    """Figures, configuration values and advice. rows_delay : by how many rows the mask was sent its
    pictures later, by the display and by the photos together."""
    config = session.config
    planes = config.display.planes_per_refresh
    rows = rows_delay + found.delay_refreshes
    refreshes = round(rows / planes)
    late_s = found.lag_s + found.apart_s
    late_s = late_s + (refreshes * planes - rows_delay) * session.refresh_s
    words = {
        name: ConfigValue(float(value), float(sigma))
        for name, value, sigma in zip(TAUS, found.taus_s, found.taus_sigma_s, strict=True)
    }
    by_row = _row_words(found, rig.mask)
    skew_s, scan_s = by_row["mask.skew_s"].value, by_row["mask.scan_s"].value
    words |= by_row
    words |= {
        "projector.skew_s": ConfigValue(0.0),
        "projector.scan_s": ConfigValue(0.0),
        "display.mask_delay_refreshes": ConfigValue(refreshes),
    }
    needed_s = float(np.abs(late_s).max() + _SETTLED * found.taus_s.max())
    if scan_s:
        needed_s = max(needed_s, abs(scan_s) + abs(skew_s))
    advice = _advice(found, session.refresh_s)
    if needed_s > config.rig.settle_s:
        settle_s = ceil(1e3 * needed_s) / 1e3
        words["rig.settle_s"] = ConfigValue(settle_s)
        advice.append(
            f"the panels need {1e3 * settle_s:.0f} ms to go black: rig.settle_s, which was "
            f"{1e3 * config.rig.settle_s:.0f} ms, is set to that"
        )
    if refreshes != config.display.mask_delay_refreshes:
        advice.append(
            f"the mask's pictures have to be sent {abs(refreshes)} refreshes "
            f"{'later' if refreshes > 0 else 'earlier'}: display.mask_delay_refreshes is set to "
            f"{refreshes}, which takes effect at the next start"
        )
    delay = MeasuredFigure("display.mask_delay_refreshes", float(refreshes), 0.0, "", "-60 to 60")
    return StepOutcome(
        figures=(*found.figures(), delay, *_leaks(found, late_s)),
        words=words,
        arrays=_arrays(found),
        advice=tuple(advice),
        picture=lambda figure: draw_timing(figure, found, readings),
    )


def _row_words(found: MeasuredTiming, mask: Map) -> dict[str, ConfigValue]:
    """The lag by row as values of [mask]; no scan where none is seen.

    The rows of a band share one delay in the configuration, that of the band's middle. So the
    delays of the first and the last band differ by less than those of the first and the last row.
    """
    scan_sigma_s = float(np.sqrt(found.line_covariance[1, 1]))
    at = np.array([1.0, 0.5])
    sigma_s = float(np.sqrt(at @ found.line_covariance @ at))
    slope_s = abs(found.line_s[1])
    if slope_s < max(min(3.0 * scan_sigma_s, _FLAT_S), _NO_SCAN_S):
        skew_s, scan_s, bands = float(at @ found.line_s), 0.0, 1
    else:
        sigma_s = float(np.hypot(sigma_s, 0.5 * scan_sigma_s))
        skew_s, scan_s = found.panel_words(mask)
        bands = 1 + ceil(min(abs(scan_s) / _STEP_S, _MOST_BANDS - 1))
        skew_s += 0.5 * abs(scan_s) / bands
        scan_s *= (bands - 1) / bands
    return {
        "mask.skew_s": ConfigValue(skew_s, sigma_s),
        "mask.scan_s": ConfigValue(scan_s, scan_sigma_s),
        "mask.scan_bands": ConfigValue(bands),
    }


def _leaks(found: MeasuredTiming, late_s: Floats) -> list[MeasuredFigure]:
    """What each schedule will leak, in the worst band, once the delay is compensated; only the best
    schedule is judged."""
    leaks = {name: max(found.kept(name, float(late)).leak for late in late_s) for name in SLOTS}
    best = min(leaks, key=lambda name: leaks[name])
    figures = []
    for name, leak in leaks.items():
        verdict = Verdict.GOOD
        if name == best:
            verdict = Verdict(int(leak > _LEAKS[0]) + int(leak > _LEAKS[1]))
        limit = f"best schedule, below {_LEAKS[0]:g}" if name == best else ""
        figures.append(MeasuredFigure(f"leak.{name}", min(leak, 1e3), 0.0, "", limit, verdict))
    return figures


def _advice(found: MeasuredTiming, refresh_s: float) -> list[str]:
    advice = [describe_room_light(found.room)] if found.room > ROOM_GOOD else []
    advice += [text for text in found.causes if text not in advice]
    slope_s = found.line_s[1]
    if abs(slope_s) > _AGAINST * refresh_s:
        sure = abs(slope_s) > _ONE_PANEL * refresh_s
        advice.append(
            f"the mask's rows come {1e3 * abs(slope_s):.1f} ms apart from the projector's between "
            "top and bottom: "
            + ("" if sure else "only one of the panels is set row by row, or ")
            + "the panels are set in opposite directions. "
            + ("Mount" if sure else "Where both are, mount")
            + " one of them turned by 180 degrees (turning its picture by software changes "
            "nothing), then calibrate again from the geometry on"
        )
    if found.tail is not None:
        panel = "mask" if found.tail.mask else "projector"
        advice.append(
            f"{100.0 * found.tail.share:.0f} % of the {panel}'s light follows "
            f"{found.tail.slower:.1f} times as slowly as the rest, which the configuration cannot "
            "describe: "
            "switch off overdrive and dynamic modes"
        )
    return advice


def _arrays(found: MeasuredTiming) -> dict[str, Floats]:
    """Arrays for checks and later steps."""
    tail = found.tail
    return {
        "timing.lag_s": found.lag_s,
        "timing.across_s": np.array(found.across_s),
        "timing.taus_s": found.taus_s,
        "timing.taus_sigma_s": found.taus_sigma_s,
        "timing.leaks": found.leaks,
        "timing.tail": np.array(
            [0.0, 0.0, 1.0] if tail is None else [tail.mask, tail.share, tail.slower]
        ),
    }
