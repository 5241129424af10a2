"""Contrasts, room light, brightness, the stops of the lens, and whether the lamp is steady."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import camera_map
from pdcd.bench.stops import stop_of
from pdcd.calibration.figures import Figure, Verdict, darken
from pdcd.calibration.light.contrasts import Light, measure_light, responsivity_of
from pdcd.calibration.light.lamp import lamp_of
from pdcd.calibration.light.light_plan import COVERED, Edges, LightPlan
from pdcd.calibration.light.metering import opened
from pdcd.calibration.light.stop_series import Stops, measure_stops
from pdcd.calibration.photo import (
    BLOCK_QUADS,
    Blocks,
    Photo,
    Seen,
    block_means,
    blocks_of,
    refuse_settings,
)
from pdcd.calibration.script import (
    Ask,
    Measured,
    Outcome,
    Script,
    Session,
    Taken,
    Wanted,
    take,
)
from pdcd.calibration.sensor.sensor_step import BLACK, EDGE, GAIN
from pdcd.calibration.shown import Shown
from pdcd.panels.map import Map, between

Floats = NDArray[np.float64]
Marks = NDArray[np.bool_]

LIT = 60
"""White refreshes of a photo of an open mask: a second."""
LONG = 600
"""Refreshes that the photos of closed panels take, or twice those of open ones."""
LAMP_PHOTOS = 3
"""More photos of white, for the lamp."""
UNKNOWN_CARD = 0.9, 0.05
"""Albedo of a white card of which nobody says anything, and its standard deviation: from paper to
pressed PTFE."""
SAID_SIGMA = 0.01
"""The same where somebody said it."""
BLACK_SIGMA_DN = 0.3
"""Of a black level that was never measured; and below 0.1 nobody should believe."""
LEAST_BLACK_DN = 0.1
UNKNOWN_EDGE_S = 0.004
GUESSED_GAIN = 0.2
"""Relative error of a gain out of a table."""
FIELD_LIT = 0.9
COVER = "cover the projector's lens with its cap; leave all else as it is"
UNCOVER = "take the cap off the projector's lens again"
ADVICE = {
    "projector.contrast": "black of the projector is bright: see that its picture mode is not "
    "dynamic, and darken the room",
    "mask.contrast": "the mask leaks: turn its polariser a little and calibrate light again",
    "light.lamp_change": "the lamp drifts: let it warm up for half an hour",
    "light.lamp_drift": "the lamp drifts: let it warm up for half an hour",
    "light.lamp_flicker": "the lamp flickers: switch eco mode off; show codes for longer",
    "light.field_lit": "part of the field gets no light where it lay at the last calibration: take "
    "away what covers it, then calibrate the geometry",
}


@dataclass
class _Taking:
    """The photos of this step, as they come.

    blocks : those of the series, by blocks. white : mean light of all photos of plain white, with
    their relative noise and the times of their beginning.
    """

    session: Session
    f_number: float | None
    blocks: dict[str, Blocks] = field(default_factory=dict)
    white: list[tuple[float, float, float]] = field(default_factory=list)
    seen: dict[str, Seen] = field(default_factory=dict)
    open_s: dict[str, float] = field(default_factory=dict)

    def photo(self, shown: Shown, covered: bool = False) -> Generator[Wanted | Ask, Taken, Photo]:
        """Take one photo."""
        taken = yield from take(Wanted(shown, f_number=self.f_number, covered=covered))
        self.seen[shown.name], self.open_s[shown.name] = taken.seen, taken.open_s
        photo = self.session.photo(taken)
        if shown.name.startswith(("WW", "lamp")):
            blocks = blocks_of(photo)
            level = float(blocks.mean.mean())
            noise = float(np.sqrt(blocks.variance.sum())) / blocks.mean.size / max(level, 1e-9)
            self.white.append((taken.open_ns * 1e-9, level, noise))
        return photo


def light(session: Session) -> Script:
    """Both panels white and black in all four ways, and white at every stop that may be used."""
    f_number, full = opened(session, LIT)
    longer = int(np.clip(LONG // full, 2, 8))
    plan = LightPlan(refreshes=full, longer=longer, refresh_s=session.refresh_s)
    taking = _Taking(session, f_number)
    series = [shown for shown in plan.photos() if shown.name not in COVERED]
    for shown in series:
        white = yield from taking.photo(shown)
        taking.blocks[shown.name] = blocks_of(white)
        for number in range(LAMP_PHOTOS if shown.name == "WW" else 0):
            yield from taking.photo(replace(shown, name=f"lamp-{number + 1}"))
    if session.helped:
        yield from _covered(plan, taking)
    found = measure_light(
        taking.blocks,
        plan,
        edges=_edges(session),
        black_sigma=_black_sigma(session),
        field=_field(session, white.frame) if "geometry" in session.done else None,
    )
    lit = _field_lit(session, white)
    refuse_settings(taking.seen, iso=session.iso, f_number=f_number, open_s=taking.open_s)
    stops = Stops()
    if f_number is not None:
        stops = yield from measure_stops(session, f_number, full, _black_sigma(session))
    times, levels, noise = np.array(taking.white).T
    figures = (
        *found.figures(_card(session)[0]),
        *lamp_of(times - times[0], levels, float(noise.max())).figures(),
        *stops.figures(),
        *lit,
    )
    return _outcome(session, found, white, stops, figures, f_number)


def _card(session: Session) -> tuple[float, float]:
    """The card's albedo, and its standard deviation."""
    said = session.config.calibration.card_albedo
    return UNKNOWN_CARD if said is None else (said, SAID_SIGMA)


def _covered(plan: LightPlan, taking: _Taking) -> Generator[Wanted | Ask, Taken | None, None]:
    """The photos with the projector's lens covered."""
    yield Ask(COVER)
    for shown in plan.photos():
        if shown.name in COVERED:
            photo = yield from taking.photo(shown, covered=True)
            taking.blocks[shown.name] = blocks_of(photo)
    yield Ask(UNCOVER)


def _outcome(
    session: Session,
    found: Light,
    white: Photo,
    stops: Stops,
    figures: tuple[Figure, ...],
    f_number: float | None,
) -> Outcome:
    """All figures and words."""
    words, arrays = {}, {}
    albedo, albedo_sigma = _card(session)
    for name, share in (("projector", found.projector), ("mask", found.mask)):
        contrast, error = share.contrast
        words[f"{name}.contrast"] = Measured(contrast, error or None)
    fixed = session.config.camera.f_number
    number = f_number if f_number is not None or fixed == "auto" else fixed
    advice = [
        darken(found.room.value)
        if f.name == "scene.ambient" and found.room is not None
        else ADVICE[f.name]
        for f in figures
        if f.verdict is not Verdict.GOOD
    ]
    if number is None:
        advice.append("the lens does not tell its f-number: set camera.f_number to what it says")
    else:
        value, sigma = responsivity_of(
            found,
            gain_e_per_dn=_gain(session),
            f_number=stop_of(number, stops.found).true,
            albedo=albedo,
            albedo_sigma=albedo_sigma,
        )
        red, green, blue = value.tolist()
        words["camera.stops"] = Measured(msgspec.to_builtins(stops.found))
        words["camera.responsivity_e"] = Measured((red, green, blue), tuple(sigma.tolist()))
        figures = (
            *figures,
            Figure("camera.responsivity_e", green, float(sigma[1]), "e-/s", "of green"),
        )
    if found.room is None and found.projector.seen:
        advice.append(
            "black of the projector and light of the room were not told apart: calibrate with "
            "somebody there to cover the projector's lens"
        )
    ambient = found.ambient(albedo)
    if ambient is not None:
        arrays["light.ambient"] = np.array(ambient)
    arrays["light.rate_dn"] = found.rate
    arrays["light.mask_leak"] = np.nan_to_num(found.mask_map)
    return Outcome(
        figures=figures,
        words=words,
        arrays=arrays,
        advice=tuple(dict.fromkeys(advice)),
        picture=lambda figure: _draw(figure, found, white),
    )


def _edges(session: Session) -> Edges:
    """What the panels' edges add: the projector's as measured with the sensor, else as believed."""
    projector, mask = session.config.projector, session.config.mask
    of_mask = mask.fall_s - mask.rise_s
    known = session.arrays.get(EDGE)
    if known is None:
        return Edges(projector.fall_s - projector.rise_s, of_mask, UNKNOWN_EDGE_S)
    return Edges(float(known[0]), of_mask, float(known[1]))


def _black_sigma(session: Session) -> float:
    """Standard deviation of one photo's black level in DN."""
    known = session.arrays.get(BLACK)
    return BLACK_SIGMA_DN if known is None else max(float(known[0]), LEAST_BLACK_DN)


def _gain(session: Session) -> tuple[float, float]:
    """e- per DN, and its standard deviation."""
    known = session.arrays.get(GAIN)
    if known is not None and not session.profile.estimated:
        return float(known[0]), float(known[1])
    gain = session.profile.row(session.iso).gain_e_per_dn
    return gain, GUESSED_GAIN * gain if session.profile.estimated else 0.0


def _field(session: Session, frame: tuple[int, int]) -> Marks | None:
    """Quads that see the field, (h, w); None where nobody has measured it."""
    panel = session.config.projector.place.map
    if not isinstance(panel, Map) or session.config.camera.place.map is None:
        return None
    camera = camera_map(session.config, frame)
    (rows, cols), (left, top, wide, high) = frame, session.on_field.projector.field_box_px
    x, y = (np.arange(0, n, BLOCK_QUADS) + 0.5 * BLOCK_QUADS for n in (cols, rows))
    places = between(camera, panel, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        inside = ((places >= (left, top)) & (places <= (left + wide, top + high))).all(axis=-1)
    blocks = inside.reshape(y.size, x.size)
    return np.asarray(blocks.repeat(BLOCK_QUADS, 0).repeat(BLOCK_QUADS, 1)[:rows, :cols])


def _field_lit(session: Session, white: Photo) -> tuple[Figure, ...]:
    """How much of the field, where it was last found, gets light. That may have been long ago."""
    field = _field(session, white.frame)
    if field is None:
        return ()
    bright = white.light.sum(axis=2)
    share = float((bright[field] > 0.1 * np.quantile(bright, 0.98)).mean())
    verdict = Verdict.GOOD if share >= FIELD_LIT else Verdict.DOUBTFUL
    return (Figure("light.field_lit", share, 0.0, "", f"{FIELD_LIT:g} or more", verdict),)


def _draw(figure: Any, found: Light, white: Photo) -> None:
    """Light over the field, and the mask's contrast."""
    bright = block_means(white.light.mean(axis=2))
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast = 1.0 / found.mask_map
    for axes, title, values, most in zip(
        figure.subplots(1, 2), ("light of a white card", "contrast of the mask"),
        (bright / np.quantile(bright, 0.98), contrast), (1.0, 2.0 * found.mask.contrast[0]),
        strict=True,
    ):  # fmt: skip
        figure.colorbar(axes.imshow(values, vmin=0.0, vmax=most), orientation="horizontal")
        axes.set_title(title, fontsize=10)
