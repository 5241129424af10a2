"""Grey levels of both panels: gamma, and a table of levels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import make_camera_map
from pdcd.calibration.light.metering import choose_wide_aperture
from pdcd.calibration.photo import QuadPhoto, RawSettings, check_camera_settings
from pdcd.calibration.preview import PLOT_BLUE, PLOT_RED, label_plot
from pdcd.calibration.response.levels import (
    DITHER_CYCLE,
    GreyResponse,
    draw_level_pictures,
    find_seen_strips,
    measure_grey_response,
)
from pdcd.calibration.script import (
    CalibrationSession,
    ConfigValue,
    PhotoRequest,
    StepOutcome,
    StepScript,
    take_photo,
)
from pdcd.calibration.shown import PanelName, make_sole_sequence

HELD = 128
"""Refreshes for which a picture is held, at least: changes from grey to grey are slow."""
_PANELS: tuple[PanelName, ...] = ("projector", "mask")
_LAW = 0.004
"""Largest misfit with which a power law is used: about half a step of 8 bits near white, at gamma
2.2."""
_BENT, _COLOURED = 0.01, 0.1
"""Misfit of a power law, and difference of the colours' gammas, from which there is advice."""


def calibrate_response(session: CalibrationSession) -> StepScript:
    """White, black, and strips of 17 levels in two orders, of each panel: eight photos."""
    f_number, full = choose_wide_aperture(session, HELD)
    held = -(-full // DITHER_CYCLE) * DITHER_CYCLE
    seen: dict[str, RawSettings] = {}
    found = []
    for panel, size in zip(_PANELS, session.sizes, strict=True):
        photos: dict[str, QuadPhoto] = {}
        for name, picture in draw_level_pictures(size).items():
            shown = make_sole_sequence(f"{panel}-{name}", held, panel, picture)
            taken = yield from take_photo(PhotoRequest(shown, f_number=f_number))
            photos[name] = session.photo(taken)
            seen[taken.name] = taken.seen
        check_camera_settings(seen, iso=session.iso, f_number=f_number)
        camera = make_camera_map(session.config, photos["white"].frame)
        strips = find_seen_strips(camera, session.found(panel))
        found.append(measure_grey_response(photos, strips, panel))
    arrays: dict[str, NDArray[np.generic]] = {}
    for one in found:
        arrays[f"{one.panel}.grey.levels"] = one.levels
        arrays[f"{one.panel}.grey.light"] = np.stack([one.light, one.sigma])
        arrays[f"{one.panel}.grey.level_for"] = one.level_for()
    words: dict[str, ConfigValue] = {}
    for one in found:
        words |= _words(one)
    return StepOutcome(
        words=words,
        figures=tuple(figure for one in found for figure in one.figures()),
        arrays=arrays,
        advice=tuple(text for one in found for text in _advice(one)),
        picture=lambda figure: _draw(figure, found),
    )


def _words(found: GreyResponse) -> dict[str, ConfigValue]:
    """The configuration values that captures use: gamma where the panel follows it, else the
    table."""
    law = found.misfit <= _LAW
    gamma = ConfigValue(found.gamma, found.gamma_sigma) if law else ConfigValue(None)
    lights = found.light_of()
    lights[[0, -1]] = 0.0, 1.0
    lut = None if law else tuple(np.round(lights, 6).tolist())
    table = ConfigValue(lut, None if law else float(found.sigma.max()))
    return {f"{found.panel}.gamma": gamma, f"{found.panel}.lut": table}


def _advice(found: GreyResponse) -> tuple[str, ...]:
    """What to do about it."""
    told = []
    if found.misfit > _BENT:
        told.append(
            f"grey of the {found.panel} follows no power law: it is sent by the measured table; "
            "see that picture modes are off"
        )
    if max(found.channel_gammas) - min(found.channel_gammas) > _COLOURED:
        told.append(
            f"greys of the {found.panel} are coloured: set its colour temperature to native"
        )
    return tuple(told)


def _draw(figure: Any, found: list[GreyResponse]) -> None:
    """Light over level of both panels, beside their power laws."""
    axes, grey = figure.subplots(), np.arange(256.0)
    for one, (colour, marker) in zip(found, ((PLOT_RED, "o"), (PLOT_BLUE, "s")), strict=True):
        text = f"{one.panel}: gamma {one.gamma:.3f} +- {one.gamma_sigma:.3f}"
        axes.plot(grey, (grey / 255.0) ** one.gamma, color=colour)
        axes.plot(
            one.levels, one.light, marker, color=colour,
            label=f"{text}, off the law by {100.0 * one.misfit:.2g} %",
        )  # fmt: skip
    axes.legend()
    label_plot(axes, "Light of grey levels", "level, of 255", "light, of white")
