"""How much light the stops of a lens let through, relative to the one at which light was measured.

White is shown as codes are: both panels are white and black together, so light is proportional to
the number of pulses, whatever the panels' edges and the room add. A wide stop gets few pulses and a
narrow one many, so that all photos are about equally bright. Stops at which one pulse is too bright
are compared with the widest of the others, by short flashes of the projector.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass

import numpy as np

from pdcd.bench.stops import Stop, stop_of
from pdcd.calibration.figures import MeasuredFigure
from pdcd.calibration.light.metering import FULL_SHARE
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    PhotoRequest,
    UserPrompt,
    take_photo,
)
from pdcd.calibration.shown import NO_PATTERNS, PanelSequence
from pdcd.panels.frames import BLACK, WHITE

_PULSE, _PAUSE = 4, 6
"""Refreshes of a pulse, and after it: a mask that is late by fewer than these still meets its own
pulse."""
_FLASH = 2
"""The refresh of a pulse in which the projector is white in a short one. The mask is open before
and after it, so it may be early or late."""
_LEVEL = 0.4
"""Share of saturation that a photo is to reach."""
_DIMMEST, _BRIGHTEST = 0.06, 0.6
"""Least and most share of saturation: some three stops either way."""
_MOST_PULSES = 12
"""Of two seconds."""
_LEAST_GOOD = 0.999
"""Least share of a photo that must not be saturated: hot pixels stay below the rest."""
_AGAIN = "again"
"""Name of the last photo, of the first stop again: it shows what the lamp did meanwhile."""


@dataclass(frozen=True)
class _StopPhoto:
    """One photo of a stop, with so many pulses. short : each pulse is a flash of the projector."""

    f_number: float
    pulses: int
    name: str
    short: bool = False


def plan_stop_photos(
    f_numbers: tuple[float, ...], own: float, per_pulse: float, *, short: bool = False
) -> tuple[_StopPhoto, ...]:
    """The photos that compare the stops of a lens with its `own` one, at which a pulse gives the
    share `per_pulse` of saturation. The first and the last are of that stop."""
    kind = "flash" if short else "stop"
    photos = []
    for f_number in sorted(f_numbers):
        each = per_pulse * (own / f_number) ** 2
        pulses = min(max(1, round(_LEVEL / each)), _MOST_PULSES)
        if f_number != own and _DIMMEST <= pulses * each <= _BRIGHTEST:
            photos.append(_StopPhoto(f_number, pulses, f"{kind}-{f_number:g}", short))
    if not photos:
        return ()
    pulses = min(max(1, round(_LEVEL / per_pulse)), _MOST_PULSES)
    first = _StopPhoto(own, pulses, f"{kind}-{own:g}", short)
    return (first, *photos, _StopPhoto(own, pulses, f"{first.name}-{_AGAIN}", short))


def _shown_of(photo: _StopPhoto) -> PanelSequence:
    """What the panels show in a photo."""
    mask = np.full(photo.pulses * (_PULSE + _PAUSE), BLACK, np.int32)
    projector = mask.copy()
    for pulse in range(photo.pulses):
        begin = pulse * (_PULSE + _PAUSE)
        mask[begin:][:_PULSE] = WHITE
        first, count = (_FLASH, 1) if photo.short else (0, _PULSE)
        projector[begin + first :][:count] = WHITE
    return PanelSequence(photo.name, NO_PATTERNS, NO_PATTERNS, projector, mask)


def list_stop_figures(stops: tuple[Stop, ...]) -> tuple[MeasuredFigure, ...]:
    """The figures of stops that were compared."""
    if not stops:
        return ()
    away = [abs(2.0 * (stop.true / stop_of(stop.f_number).true - 1.0)) for stop in stops]
    return (
        MeasuredFigure("light.stops", float(len(stops)), 0.0, ""),
        MeasuredFigure("light.stops_worst", max(away), 0.0, "", "of light, beside 2^(k/6)"),
    )


def measure_stops(
    session: CalibrationSession, own: float, full: int, black_sigma: float
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, tuple[Stop, ...]]:
    """Take the photos and compare the stops: the first, with sigma 0, is the one that the others
    were compared with. Nothing where the lens is to stay as it is, or no other stop could be
    compared.

    own : stop at which `full` refreshes of white reach `FULL_SHARE` of saturation. black_sigma :
        standard deviation of a photo's black level, in DN.
    """
    f_numbers = session.camera.f_numbers
    if session.config.camera.f_number != "auto":
        return ()
    nominal = stop_of(own)
    found: tuple[Stop, ...] = (Stop(nominal.f_number, nominal.true, 0.0),)
    for short in (False, True):
        beside = min(found, key=lambda stop: stop.f_number) if short else found[0]
        lit = 1 if short else _PULSE
        per_pulse = FULL_SHARE * lit / full * (own / beside.f_number) ** 2
        left = tuple(f for f in f_numbers if not short or f < beside.f_number)
        photos = plan_stop_photos(left, beside.f_number, per_pulse, short=short)
        taken: dict[str, tuple[float, float, float]] = {}
        for photo in photos:
            shown = session.in_step(_shown_of(photo))
            came = yield from take_photo(PhotoRequest(shown, f_number=photo.f_number))
            taken[photo.name] = _light(session.photo(came), photo.pulses, black_sigma)
        found = (*found, *_stops_of(photos, taken, beside))
    return found if len(found) > 1 else ()


def _stops_of(
    photos: tuple[_StopPhoto, ...],
    taken: Mapping[str, tuple[float, float, float]],
    beside: Stop,
) -> tuple[Stop, ...]:
    """Stops from each photo's light of a pulse, its relative standard deviation, and the share of
    the photo that is not saturated. beside : the stop that they are compared with."""
    if not photos:
        return ()
    first, *others, last = photos
    begun, ended = taken[first.name][0], taken[last.name][0]
    reference = 0.5 * (begun + ended)
    if not reference > 0.0:
        return ()
    drift = 0.5 * abs(ended - begun) / reference
    noise = taken[first.name][1] ** 2 / 2.0 + beside.sigma**2 + drift**2
    found = []
    for photo in others:
        light, sigma, good = taken[photo.name]
        if good < _LEAST_GOOD or not light > 0.0:
            continue
        true = beside.true * float(np.sqrt(reference / light))
        found.append(Stop(photo.f_number, true, float(np.sqrt(sigma**2 + noise))))
    return tuple(found)


def _light(photo: QuadPhoto, pulses: int, black_sigma: float) -> tuple[float, float, float]:
    """Light of one pulse, its relative standard deviation, share that is not saturated."""
    total = float(photo.light.sum())
    noise = float(photo.variance.sum())
    error = np.hypot(np.sqrt(noise), black_sigma * photo.light.size) / max(total, 1e-9)
    blown = 0.0 if photo.saturated is None else float(photo.saturated.mean())
    return total / pulses, float(error), 1.0 - blown
