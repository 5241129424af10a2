"""How long, and through which aperture, white light may fall on the sensor."""

from __future__ import annotations

import numpy as np

from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    PhotoRequest,
    StepOutcome,
    StepScript,
    take_photo,
)
from pdcd.calibration.shown import PanelSequence, make_still_sequence
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK, WHITE

FULL_SHARE = 0.65
"""Share of saturation that white light reaches after `Session.full` refreshes."""
WISHED = 240
"""Refreshes until then that are aimed at: long photos hold many pulses, and in short ones less
light leaks through black."""
LEAST, MOST_WHITE_REFRESHES = 67, 1200
"""The range in which all steps work."""
_TRIAL = 12
"""Refreshes of a trial photo."""
OPEN_REFRESHES = 13
"""Refreshes for which the mask is open before and after the light."""
_TRIALS = 10
_FIRST_F_NUMBER = 8.0
_DARK = 0.004
"""Share of saturation below which a trial photo is too dark to meter by."""
_BRIGHT = 0.9
_BRIGHTEST = 99.8
"""Percentile of the samples that must stay below saturation: specks of dust and hot pixels may
not."""


def meter_light(session: CalibrationSession) -> StepScript:
    """Find the aperture, and set `session.f_number` and `session.full`.

    Raises CalibrationError: no light, or too much or too little of it at every aperture.
    """
    stops = sorted(session.camera.f_numbers)
    fixed = session.config.camera.f_number
    if fixed != "auto":
        stops = [fixed] if stops else []
    f_number = min(stops, key=lambda f: abs(np.log(f / _FIRST_F_NUMBER))) if stops else None
    refreshes = _TRIAL
    for trial in range(1, _TRIALS + 1):
        shown = _lit(f"meter-{trial}", refreshes)
        taken = yield from take_photo(PhotoRequest(shown, session.iso, f_number))
        level = _brightest(session, taken)
        if level > _BRIGHT and (refreshes > 1 or _other(stops, f_number, 8.0) != f_number):
            darker = _other(stops, f_number, 4.0)
            refreshes = max(1, refreshes // 4) if darker == f_number else refreshes
            f_number = darker
            continue
        if level < _DARK and (
            refreshes < MOST_WHITE_REFRESHES or _other(stops, f_number, 0.2) != f_number
        ):
            lighter = _other(stops, f_number, 0.25)
            refreshes = (
                min(MOST_WHITE_REFRESHES, refreshes * 8) if lighter == f_number else refreshes
            )
            f_number = lighter
            continue
        break
    if level < _DARK:
        raise CalibrationError(
            f"white light of {refreshes} refreshes is {level:.2%} of saturation",
            device="camera",
            hint="take the lens cap off; see that the projector is on, that the mask lets light "
            "through, that the shutter opens and a white card is lit",
        )
    f_number, session.full = _settled(stops, f_number, level / refreshes)
    session.f_number = f_number
    if session.full < LEAST:
        raise CalibrationError(
            f"white light fills the sensor after {session.full} refreshes; {LEAST} are needed",
            device="camera",
            hint="close the lens, lower the ISO, or put a grey filter in front of it",
        )
    verdict = Verdict.GOOD if session.full <= MOST_WHITE_REFRESHES else Verdict.DOUBTFUL
    session.full = min(session.full, MOST_WHITE_REFRESHES)
    limit = f"{LEAST} to {MOST_WHITE_REFRESHES}"
    figures = [MeasuredFigure("full_refreshes", float(session.full), 0.0, "", limit, verdict)]
    if f_number is not None:  # of a lens that is set from here
        figures.append(MeasuredFigure("f_number", f_number, 0.0, "f"))
    return StepOutcome(tuple(figures))


def choose_wide_aperture(session: CalibrationSession, least: int) -> tuple[float | None, int]:
    """The widest aperture at which `FULL_SHARE` takes at least `least` refreshes, or the session's
    own; and how many it takes there. Steps that need only light can use such short photos."""
    set_to, fixed = session.f_number, session.config.camera.f_number
    if set_to is None or fixed != "auto":
        return set_to, session.full
    for stop in sorted(session.camera.f_numbers):
        full = int(session.full * (stop / set_to) ** 2)
        if full >= least and stop < set_to:
            return stop, full
    return set_to, session.full


def _lit(name: str, refreshes: int) -> PanelSequence:
    """White light of so many refreshes, through a mask that is open for longer: it is not known yet
    by how many refreshes one panel is late."""
    white = make_still_sequence(name, refreshes + 2 * OPEN_REFRESHES, WHITE, WHITE)
    white.projector_index[:OPEN_REFRESHES] = white.projector_index[-OPEN_REFRESHES:] = BLACK
    return white


def _settled(stops: list[float], f_number: float | None, rate: float) -> tuple[float | None, int]:
    """The aperture at which `WISHED` refreshes, or a few more, reach `FULL_SHARE`; and how many
    do."""
    if f_number is None or not stops:
        return f_number, int(FULL_SHARE / rate)
    wished = f_number * np.sqrt(WISHED * rate / FULL_SHARE)
    slower = [stop for stop in stops if stop >= wished]
    chosen = slower[0] if slower else stops[-1]
    return chosen, int(FULL_SHARE / rate * (chosen / f_number) ** 2)


def _other(stops: list[float], f_number: float | None, light: float) -> float | None:
    """The stop that lets through about 1 / light of the light; the last one at the end of the
    lens's range."""
    if f_number is None or not stops:
        return f_number
    wanted = f_number * np.sqrt(light)
    return min(stops, key=lambda f: abs(np.log(f / wanted)))


def _brightest(session: CalibrationSession, taken: CalibrationPhoto) -> float:
    """Light of the brightest samples, as a share of saturation."""
    full = session.profile.saturation_dn(taken.iso)
    return max(float(np.percentile(plane, _BRIGHTEST)) for plane in taken.raw.planes) / full
