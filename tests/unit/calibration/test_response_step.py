"""The step of grey levels: eight photos, what is kept of them, and what is advised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import QuadPhoto, RawSettings
from pdcd.calibration.response.response_step import HELD, calibrate_response
from pdcd.calibration.script import PhotoRequest
from pdcd.panels.frames import WHITE
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from tests.unit.calibration.scripted import Answered, Run, preview_of, run, session_of
from tests.unit.calibration.test_response import CAMERA, PANEL, Law, power, s_curve, series
from tests.unit.planning.test_measured import config


@cache
def photos_of(law: Law) -> dict[str, QuadPhoto]:
    return series(law)


GAMMA, CURVE = power(2.2), s_curve


def stepped(
    projector: Law = GAMMA,
    mask: Law = GAMMA,
    see: Callable[[dict[str, QuadPhoto]], dict[str, QuadPhoto]] = dict,
) -> tuple[Answered, Run]:
    place = Placing(map=Map.filling(PANEL))
    panel = {"size_px": PANEL, "place": place}
    tables = config(projector=panel, mask=panel, camera={"place": Placing(map=CAMERA)})

    def photo(taken: Any) -> QuadPhoto:
        panel, _, name = taken.name.partition("-")
        return see(dict(photos_of(projector if panel == "projector" else mask)))[name]

    def taken(wanted: PhotoRequest) -> Any:
        return SimpleNamespace(name=wanted.shown.name, seen=RawSettings(iso=100))

    session = session_of(tables, photo)
    session.full, session.f_number = 300, 8.0
    return session, run(calibrate_response(session), taken)


def test_each_panel_shows_its_levels_before_a_white_other_one() -> None:
    _, found = stepped()
    for one in (wanted.shown for wanted in found.wanted):
        own, other = (one.projector, one.mask), (one.projector_index, one.mask_index)
        which = 0 if one.name.startswith("projector") else 1
        assert own[which].shape == (1, PANEL[1], PANEL[0]) and not own[1 - which].size
        assert (other[which] == 0).all() and (other[1 - which] == WHITE).all()
        assert one.refreshes % 16 == 0 and one.refreshes >= HELD
    # At the widest lens at which light may be held for so long.
    assert len({wanted.f_number for wanted in found.wanted}) == 1
    f_number = found.wanted[0].f_number
    assert f_number is not None and 300 * (f_number / 8.0) ** 2 >= HELD


def test_a_panel_that_follows_its_law_is_sent_by_gamma() -> None:
    _, found = stepped()
    out = found.outcome
    assert out is not None and out.verdict is Verdict.GOOD and not out.advice
    assert preview_of(out)[:4] == b"\x89PNG"
    for panel in ("projector", "mask"):
        gamma, table = out.words[f"{panel}.gamma"], out.words[f"{panel}.lut"]
        assert gamma.value == pytest.approx(2.2, abs=0.02) and gamma.sigma is not None
        assert (table.value, table.sigma) == (None, None)


def test_a_panel_that_follows_none_is_sent_by_its_table() -> None:
    _, found = stepped(mask=CURVE)
    out = found.outcome
    assert out is not None and out.verdict is Verdict.DOUBTFUL
    assert out.words["projector.gamma"].value == pytest.approx(2.2, abs=0.02)
    gamma, table = out.words["mask.gamma"], out.words["mask.lut"]
    assert (gamma.value, gamma.sigma) == (None, None)
    lights = np.array(table.value)
    assert lights.shape == (256,) and (lights[0], lights[-1]) == (0.0, 1.0)
    assert (np.diff(lights) >= 0.0).all()
    (told,) = out.advice
    assert told.startswith("grey of the mask follows no power law")


@pytest.mark.parametrize(("bent", "told"), [(0.02, 0), (0.2, 1)])
def test_a_panel_whose_grey_is_coloured_is_told_of(bent: float, told: int) -> None:
    """Blue of its own steps follows another power than red and green."""

    def tinted(photos: dict[str, QuadPhoto]) -> dict[str, QuadPhoto]:
        white = np.maximum(photos["white"].light[..., 2], 1.0)
        for name in ("steps-a", "steps-b"):
            light = photos[name].light.copy()
            light[..., 2] = white * (np.maximum(light[..., 2], 1.0) / white) ** (1.0 + bent / 2.2)
            photos[name] = replace(photos[name], light=light)
        return photos

    _, found = stepped(see=tinted)
    out = found.outcome
    assert out is not None
    coloured = [one for one in out.advice if "coloured" in one]
    assert len(coloured) == 2 * told
