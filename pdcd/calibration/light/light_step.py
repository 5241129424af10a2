"""Contrasts, room light, brightness, the stops of the lens, and whether the lamp is steady."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import make_camera_map
from pdcd.bench.stops import Stop, stop_of
from pdcd.bench.tables import Config
from pdcd.calibration.figures import MeasuredFigure, Verdict, describe_room_light
from pdcd.calibration.light.contrasts import LightMeasurement, compute_responsivity, measure_light
from pdcd.calibration.light.end_levels import explain_level_figure
from pdcd.calibration.light.lamp import measure_lamp
from pdcd.calibration.light.light_plan import COVERED, LightPlan, PulseEdges
from pdcd.calibration.light.metering import choose_wide_aperture
from pdcd.calibration.light.stop_series import list_stop_figures, measure_stops
from pdcd.calibration.photo import (
    BLOCK_QUADS,
    BlockMeans,
    QuadPhoto,
    RawSettings,
    average_blocks,
    average_photo_blocks,
    check_camera_settings,
    pick_main,
)
from pdcd.calibration.preview import label_plot
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
from pdcd.calibration.sensor.sensor_step import BLACK_SIGMA_KEY, EDGE_KEY, GAIN_KEY
from pdcd.calibration.shown import PanelSequence
from pdcd.panels.map import Map, map_between
from pdcd.sensor.profile import NOMINAL_RESPONSIVITY_E

_Marks = NDArray[np.bool_]

_LIT = 60
"""White refreshes of a photo with the mask open: a second."""
_LONG = 600
"""Refreshes of the photos of closed panels, or twice those of open ones."""
_LAMP_PHOTOS = 3
"""Additional photos of white, for the lamp's drift."""
_UNKNOWN_CARD = 0.9, 0.05
"""Albedo of a white card where the configuration gives none, and its standard deviation: from paper
to pressed PTFE."""
_SAID_SIGMA = 0.01
"""The standard deviation where the configuration gives an albedo."""
_BLACK_SIGMA_DN = 0.3
"""Standard deviation of a black level that was never measured, and the smallest that is
believed."""
_LEAST_BLACK_DN = 0.1
_UNKNOWN_EDGE_S = 0.004
_GUESSED_GAIN = 0.2
"""Relative error of a gain out of a table."""
_FIELD_LIT = 0.9
COVER = "cover the projector's lens with its cap; leave all else as it is"
UNCOVER = "take the cap off the projector's lens again"
_ADVICE = {
    "projector.contrast": "black of the projector is bright: see that its picture mode is not "
    "dynamic and its input takes the full range (RGB 0 to 255), and darken the room",
    "mask.contrast": "the mask leaks: turn its polariser a little and calibrate light again",
    "light.lamp_change": "the lamp drifts: let it warm up for half an hour",
    "light.lamp_drift": "the lamp drifts: let it warm up for half an hour",
    "light.lamp_flicker": "the lamp flickers: switch eco mode off; show codes for longer",
    "light.field_lit": "part of the field gets no light where it lay at the last calibration: take "
    "away what covers it, then calibrate the geometry",
    "light.white_colour": "white has another colour than it should: switch night lights, colour "
    "profiles and picture modes off, see what pdcd doctor display says, and calibrate light again",
}
_COLOUR_AS_MEASURED, _COLOUR_AS_GUESSED = 1.05, 3.0
"""Largest factor by which red and blue over green may differ from an earlier measurement, and from
those of usual white light."""


@dataclass
class _Taking:
    """The photos of this step, as they come.

    blocks : all of them, by blocks. white : for all photos of plain white, the time at which each
        began, its mean light and the relative noise of that.
    """

    session: CalibrationSession
    f_number: float | None
    blocks: dict[str, BlockMeans] = field(default_factory=dict)
    white: list[tuple[float, float, float]] = field(default_factory=list)
    seen: dict[str, RawSettings] = field(default_factory=dict)
    open_s: dict[str, float] = field(default_factory=dict)

    def photo(
        self, shown: PanelSequence, covered: bool = False
    ) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto, QuadPhoto]:
        """Take one photo."""
        taken = yield from take_photo(PhotoRequest(shown, f_number=self.f_number, covered=covered))
        self.seen[shown.name], self.open_s[shown.name] = taken.seen, taken.open_s
        photo = self.session.photo(taken)
        self.blocks[shown.name] = blocks = average_photo_blocks(photo)
        if shown.name.startswith(("WW", "lamp")):
            level = float(blocks.mean.mean())
            noise = float(np.sqrt(blocks.variance.sum())) / blocks.mean.size / max(level, 1e-9)
            self.white.append((taken.open_ns * 1e-9, level, noise))
        return photo


def calibrate_light(session: CalibrationSession) -> StepScript:
    """Both panels white and black in all four combinations, and white at every stop that may be
    used."""
    f_number, full = choose_wide_aperture(session, _LIT)
    longer = int(np.clip(_LONG // full, 2, 8))
    plan = LightPlan(refreshes=full, longer=longer, refresh_s=session.refresh_s)
    taking = _Taking(session, f_number)
    series = [shown for shown in plan.photos() if shown.name not in COVERED]
    for shown in series:
        white = yield from taking.photo(shown)
        for number in range(_LAMP_PHOTOS if shown.name == "WW" else 0):
            yield from taking.photo(replace(shown, name=f"lamp-{number + 1}"))
    if session.config.display.planes_per_refresh == 1:  # others show black and white only
        for shown in plan.levels(session.sizes):
            yield from taking.photo(shown)
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
    check_camera_settings(taking.seen, iso=session.iso, f_number=f_number, open_s=taking.open_s)
    stops: tuple[Stop, ...] = ()
    if f_number is not None:
        stops = yield from measure_stops(session, f_number, full, _black_sigma(session))
    times, levels, noise = np.array(taking.white).T
    figures = (
        *found.figures(find_card_albedo(session.config)[0]),
        *measure_lamp(times - times[0], levels, float(noise.max())).figures(),
        *list_stop_figures(stops),
        *lit,
        *_colour(session, found),
    )
    return _outcome(session, found, white, stops, figures, f_number)


def find_card_albedo(config: Config) -> tuple[float, float]:
    """The card's albedo, and its standard deviation: as configured, else those of a usual card. For
    this step, and the acceptance of a bench."""
    said = config.calibration.card_albedo
    return _UNKNOWN_CARD if said is None else (said, _SAID_SIGMA)


def _covered(
    plan: LightPlan, taking: _Taking
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, None]:
    """The photos with the projector's lens covered."""
    yield UserPrompt(COVER)
    for shown in plan.photos():
        if shown.name in COVERED:
            yield from taking.photo(shown, covered=True)
    yield UserPrompt(UNCOVER)


def _outcome(
    session: CalibrationSession,
    found: LightMeasurement,
    white: QuadPhoto,
    stops: tuple[Stop, ...],
    figures: tuple[MeasuredFigure, ...],
    f_number: float | None,
) -> StepOutcome:
    """All figures and configuration values."""
    words, arrays = {}, {}
    albedo, albedo_sigma = find_card_albedo(session.config)
    for name, share in (("projector", found.projector), ("mask", found.mask)):
        contrast, error = share.contrast
        words[f"{name}.contrast"] = ConfigValue(contrast, error or None)
    fixed = session.config.camera.f_number
    number = f_number if f_number is not None or fixed == "auto" else fixed
    advice = [
        describe_room_light(found.room.value)
        if f.name == "scene.ambient" and found.room is not None
        else _ADVICE.get(f.name) or explain_level_figure(f.name)
        for f in figures
        if f.verdict is not Verdict.GOOD
    ]
    if number is None:
        advice.append(
            "the lens does not report its f-number: set camera.f_number to what its ring says"
        )
    else:
        value, sigma = compute_responsivity(
            found,
            gain_e_per_dn=_gain(session),
            f_number=stop_of(number, stops).true,
            albedo=albedo,
            albedo_sigma=albedo_sigma,
        )
        words["camera.stops"] = ConfigValue(msgspec.to_builtins(stops))
        name, both = "camera.responsivity_e", (tuple(value.tolist()), tuple(sigma.tolist()))
        words[name] = ConfigValue(*both)
        main, unsure = (pick_main(one) for one in both)
        of = "of green" if value.size > 1 else "of grey"
        figures = (*figures, MeasuredFigure(name, main, unsure, "e-/s", of))
    if found.room is None and found.projector.seen:
        advice.append(
            "the projector's black and the room's light could not be separated: calibrate with "
            "somebody there to cover the projector's lens"
        )
    ambient = found.ambient(albedo)
    if ambient is not None:
        arrays["light.ambient"] = np.array(ambient)
    arrays["light.rate_dn"] = found.rate
    arrays["light.mask_leak"] = np.nan_to_num(found.mask_map)
    return StepOutcome(
        figures=figures,
        words=words,
        arrays=arrays,
        advice=tuple(dict.fromkeys(advice)),
        picture=lambda figure: _draw(figure, found, white),
    )


def _edges(session: CalibrationSession) -> PulseEdges:
    """What the panels' edges add: the projector's as measured with the sensor, else as
    configured."""
    projector, mask = session.config.projector, session.config.mask
    of_mask = mask.fall_s - mask.rise_s
    known = session.arrays.get(EDGE_KEY)
    if known is None:
        return PulseEdges(projector.fall_s - projector.rise_s, of_mask, _UNKNOWN_EDGE_S)
    return PulseEdges(float(known[0]), of_mask, float(known[1]))


def _black_sigma(session: CalibrationSession) -> float:
    """Standard deviation of one photo's black level in DN."""
    known = session.arrays.get(BLACK_SIGMA_KEY)
    return _BLACK_SIGMA_DN if known is None else max(float(known[0]), _LEAST_BLACK_DN)


def _gain(session: CalibrationSession) -> tuple[float, float]:
    """e- per DN, and its standard deviation."""
    known = session.arrays.get(GAIN_KEY)
    if known is not None and not session.profile.estimated:
        return float(known[0]), float(known[1])
    gain = session.profile.row(session.iso).gain_e_per_dn
    return gain, _GUESSED_GAIN * gain if session.profile.estimated else 0.0


def _field(session: CalibrationSession, frame: tuple[int, int]) -> _Marks | None:
    """Quads that see the field, (h, w); None where that was not measured."""
    panel = session.config.projector.place.map
    if not isinstance(panel, Map) or session.config.camera.place.map is None:
        return None
    camera = make_camera_map(session.config, frame)
    (rows, cols), (left, top, wide, high) = frame, session.on_field.projector.field_box_px
    x, y = (np.arange(0, n, BLOCK_QUADS) + 0.5 * BLOCK_QUADS for n in (cols, rows))
    places = map_between(camera, panel, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        inside = ((places >= (left, top)) & (places <= (left + wide, top + high))).all(axis=-1)
    blocks = inside.reshape(y.size, x.size)
    return np.asarray(blocks.repeat(BLOCK_QUADS, 0).repeat(BLOCK_QUADS, 1)[:rows, :cols])


def _field_lit(session: CalibrationSession, white: QuadPhoto) -> tuple[MeasuredFigure, ...]:
    """How much of the field, where it was last found, gets light. That may have been long ago."""
    field = _field(session, white.frame)
    if field is None:
        return ()
    bright = white.light.sum(axis=2)
    share = float((bright[field] > 0.1 * np.quantile(bright, 0.98)).mean())
    verdict = Verdict.GOOD if share >= _FIELD_LIT else Verdict.DOUBTFUL
    return (MeasuredFigure("light.field_lit", share, 0.0, "", f"{_FIELD_LIT:g} or more", verdict),)


def _colour(session: CalibrationSession, found: LightMeasurement) -> tuple[MeasuredFigure, ...]:
    """By which factor red or blue over green differs from what it was, or from what it usually is;
    nothing for a camera without colours.

    A night light dims blue and green in all that is shown; nothing else reveals it.
    """
    measured = "camera.responsivity_e" in session.config.calibration.typed
    known = session.config.camera.responsivity_e if measured else NOMINAL_RESPONSIVITY_E
    if found.rate.size == 1:
        return ()
    off = np.log(found.rate / np.array(known))
    factor = float(np.exp(np.abs(off[[0, 2]] - off[1]).max()))
    most = _COLOUR_AS_MEASURED if measured else _COLOUR_AS_GUESSED
    verdict = Verdict.GOOD if factor <= most else Verdict.DOUBTFUL
    limit = f"{most:g} or less"
    return (MeasuredFigure("light.white_colour", factor, 0.0, "times", limit, verdict),)


def _draw(figure: Any, found: LightMeasurement, white: QuadPhoto) -> None:
    """Light over the field, and the mask's contrast."""
    bright = average_blocks(white.light.mean(axis=2))
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast = 1.0 / found.mask_map
    rows, cols = (BLOCK_QUADS * n for n in bright.shape)
    figure.set_size_inches(10.0, 4.8)
    for axes, title, unit, values, most in zip(
        figure.subplots(1, 2), ("light of a white card", "contrast of the mask (blank: not known)"),
        ("share of the brightest", "open over closed"),
        (bright / np.quantile(bright, 0.98), contrast), (1.0, 2.0 * found.mask.contrast[0]),
        strict=True,
    ):  # fmt: skip
        shown = axes.imshow(values, vmin=0.0, vmax=most, extent=(0, cols, rows, 0))
        figure.colorbar(shown, orientation="horizontal", label=unit)
        label_plot(axes, title, "pixels from the left", "pixels from the top")
        axes.grid(visible=False)
