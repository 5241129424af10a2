"""When the light along borders is photographed, what panels show then, and what comes of it."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, PanelConfig
from pdcd.capture.worker.answers import AuxiliaryPhoto, SpoiltPhoto
from pdcd.capture.worker.border_check import photograph_borders
from pdcd.capture.worker.exposing import Orders
from pdcd.panels.draw import draw
from pdcd.panels.frames import BLACK
from pdcd.planning.border_photo import (
    BORDER_PHOTO_S,
    DARK,
    INNER,
    LIT,
    BorderFrames,
    is_border_photo_due,
    is_border_photo_needed,
)
from pdcd.planning.make import make_plan
from pdcd.planning.plan import Plan
from pdcd.protocol.request import CaptureRequest

GRID = (9, 12)


def bench(projector_px: tuple[int, int], mask_px: tuple[int, int]) -> Config:
    """Panels that lie on each other."""
    return Config(projector=PanelConfig(size_px=projector_px), mask=PanelConfig(size_px=mask_px))


APART = bench((256, 192), (400, 300))
"""Cells of 21.3 pixels of the projector and 33.3 of the mask."""


def planned(config: Config = APART, **fields: Any) -> Plan:
    return make_plan(CaptureRequest(**{"goal": "indirect", "codes": 16, **fields}), config, GRID)


@pytest.mark.parametrize(
    ("config", "fields", "is_wanted"),
    [
        (APART, {}, True),
        (APART, {"goal": "direct"}, True),
        (APART, {"window": "quarter"}, False),
        (APART, {"white": False}, False),
        (APART, {"goal": "fraction", "p": 0.25, "window": "whole"}, False),
        (bench((252, 189), (396, 297)), {}, False),  # cells of 21 and 33 pixels
        (bench((256, 192), (256, 192)), {}, False),
    ],
)
def test_a_photo_is_taken_where_it_tells_something(
    config: Config, fields: dict[str, Any], is_wanted: bool
) -> None:
    assert is_border_photo_needed(planned(config, **fields), config) is is_wanted


def test_it_comes_after_the_white_photo() -> None:
    plan = planned()
    assert not is_border_photo_due(plan, set())
    assert is_border_photo_due(plan, {"white"})


@pytest.mark.parametrize("name", [LIT, INNER, DARK])
def test_both_panels_are_nearly_dark_and_each_pixel_has_its_turn(name: str) -> None:
    plan, panels = planned(), panels_of(APART)
    shown = BorderFrames.of(plan, APART, 0.1)
    frames = shown.frames(name)
    mask = sum(draw(frames, panels.mask, row) > 0 for row in range(len(frames)))
    lit = sum(draw(frames, panels.projector, row) > 0 for row in range(len(frames)))
    rows = round(shown.phase_s(name) * APART.row_hz)
    assert rows >= 1 and (rows == shown.rows if name == LIT else shown.rows >= rows)
    assert 0.02 < np.mean(np.asarray(mask) > 0) < 0.3
    assert set(np.unique(mask)) == {0, rows, 3 * rows}  # beside one border, or two
    assert np.any(lit) == (name != DARK)
    assert np.all(frames.dual_index[-shown.pause :] == BLACK)


def test_the_brightest_quad_gets_no_more_light_than_in_the_white_photo() -> None:
    rows = [BorderFrames.of(planned(), APART, widest).rows for widest in (1.0, 0.5, 0.25)]
    assert rows[1] == pytest.approx(2 * rows[0], abs=1)
    assert rows[2] == round(BORDER_PHOTO_S * APART.row_hz)  # and no longer than that


class Exposing:
    """An aperture that is known."""

    def aperture(self, *_: Any) -> Generator[Any, Any, float]:
        return 4.0
        yield

    def settings(self, f_number: float) -> CameraSettings:
        return CameraSettings(100, f_number)


def taken(*photos: Any) -> tuple[Any, list[str], Orders]:
    """What comes of these photos, and the names of those that were asked for."""
    orders, names, answer = Orders(), [], iter(photos)
    steps = photograph_borders(planned(), APART, 0.1, Exposing(), orders)  # type: ignore[arg-type]
    order = next(steps)
    try:
        while True:
            assert order.photo is not None
            names.append(order.photo.name)
            order = steps.send(next(answer))
    except StopIteration as end:
        return end.value, names, orders


def test_the_run_remembers_all_photos() -> None:
    lit, inner, dark = (AuxiliaryPhoto(((f"raw/{n}.dng", n[0] * 64),), 2.0) for n in "abc")
    found, names, _ = taken(lit, inner, dark)
    assert names == [LIT, INNER, DARK]
    assert [p.raw for p in (found, found.inner, found.dark)] == [f"raw/{n}.dng" for n in "abc"]
    assert found.f_number == 4.0
    assert all(0.0 < reach < 0.1 for reach in found.reach)
    assert found.phase_s >= found.inner.phase_s == found.dark.phase_s > 0.0


def test_a_display_without_pictures_of_pixels_is_told_of() -> None:
    found, names, orders = taken(SpoiltPhoto("the display takes no frames of pixels (old)"))
    assert found is None and names == [LIT]
    (note,) = orders.end().notes
    assert isinstance(note, str) and "a larger error (the display takes no frames" in note
