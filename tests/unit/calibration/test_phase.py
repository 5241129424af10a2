"""Stripes and codes: what each quad sees, its error, and what is no answer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.geometry.panel_map import fit_decoded_quads
from pdcd.calibration.geometry.phase import (
    DecodedQuads,
    PhaseCode,
    Sines,
    check_periods,
    join_axes_on_panel,
)
from pdcd.calibration.geometry.xor import XorCode, XorPlanes
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import PanelSequence
from pdcd.errors import CalibrationError
from tests.unit.calibration.geometry_bench import Bench, Way

Floats = NDArray[np.float64]

FRAME = (200, 300)
SIZE = (160, 120)
WAY = Way(SIZE, FRAME, scale=1.5, turn_deg=2.0, keystone=(0.06, -0.02))
CODE = PhaseCode("projector", SIZE)
STRIPES = CODE.shown(0) + CODE.shown(1)
QUADS = np.stack(np.meshgrid(np.arange(300) + 0.5, np.arange(200) + 0.5), axis=-1)
TRUE = WAY.to_panel(QUADS)
MIDDLE = ((TRUE > 6.0) & (TRUE < np.array(SIZE) - 6.0)).all(axis=-1)


def bench(**changes: Any) -> Bench:
    mask = Way((100, 80), FRAME, scale=4.0, waves_px=0.0)
    return replace(Bench(WAY, mask, samples=3), **changes)


def photos(shown: tuple[PanelSequence, ...], seed: int = 0, **changes: Any) -> Iterator[QuadPhoto]:
    """One after the other, as they come from a disk."""
    made = bench(**changes)
    return (made.photo(one, 100 * seed + number) for number, one in enumerate(shown))


def decode_by_prior(photos: Iterable[QuadPhoto], code: PhaseCode, prior_px: Floats) -> DecodedQuads:
    """Panel pixels out of the photos of `code.shown` for either axis, by a belief (h, w, 2), as the
    step does it photo by photo."""
    taken = iter(photos)
    axes = [_sines(taken, code).place(prior_px[..., axis]) for axis in (0, 1)]
    found = join_axes_on_panel(axes, code)
    check_periods(found, prior_px, code)
    return found


def decode_xor(photos: Iterable[QuadPhoto], code: XorCode) -> DecodedQuads:
    """Panel pixels, whole ones, out of the photos of `code.shown()`, in its order."""
    planes = XorPlanes(code)
    for photo in photos:
        planes.add(photo)
    return planes.decoded()


def _sines(taken: Iterator[QuadPhoto], code: PhaseCode) -> Sines:
    sines = Sines(code, 1)
    for photo in islice(taken, code.steps):
        sines.add(photo)
    sines.refuse_flat()
    return sines


def decode(seen: Iterator[QuadPhoto]) -> DecodedQuads:
    """By a belief that is a third of a period off."""
    return decode_by_prior(seen, CODE, TRUE + np.array([5.0, -5.5]))


def error(found: DecodedQuads) -> Floats:
    kept: Floats = (found.panel_px - TRUE)[found.valid]
    return kept


def test_sixteen_black_and_white_pictures_make_a_sine_of_one_run() -> None:
    for axis in (0, 1):
        for step in range(4):
            sine = CODE.sine(axis, step)
            assert sine.shape == (16, 120, 160)
            # Lit from the first refresh on, or never; no pixel comes on again.
            assert not (sine[1:] & ~sine[:-1]).any()
            line = sine.mean(axis=0)[0] if axis == 0 else sine.mean(axis=0)[:, 0]
            x = np.arange(SIZE[axis]) + 0.5
            wanted = 0.5 + 0.5 * np.cos(2.0 * np.pi * (x / 16.0 - step / 4.0))
            assert np.abs(line - wanted).max() <= 0.5 / 16.0 + 1e-12


@pytest.mark.long
def test_stripes_tell_each_quad_its_pixel() -> None:
    found = decode(photos(STRIPES))
    assert found.valid[MIDDLE].mean() > 0.99
    left = np.hypot(*error(found).T)
    assert np.percentile(left, 50.0) < 0.07
    assert left.max() < 1.5
    fitted = fit_decoded_quads(found, SIZE, "projector")
    assert np.percentile(np.hypot(*(fitted.to_target(QUADS[MIDDLE]) - TRUE[MIDDLE]).T), 95.0) < 0.05


def test_errors_of_stripes_are_honest_in_dim_light() -> None:
    found = decode(photos(STRIPES, electrons=300.0))
    ratio = (found.panel_px - TRUE)[found.valid & MIDDLE] / found.sigma_px[found.valid & MIDDLE]
    assert np.median(np.abs(ratio)) / 0.6745 == pytest.approx(1.0, abs=0.1)
    assert found.valid[MIDDLE].mean() > 0.8


def test_a_map_that_is_half_a_period_off_is_refused() -> None:
    with pytest.raises(CalibrationError, match="beside its stored map"):
        decode_by_prior(photos(STRIPES), CODE, TRUE + np.array([7.5, 0.0]))
    with pytest.raises(CalibrationError, match="beyond the projector"):
        decode_by_prior(photos(STRIPES), CODE, TRUE + np.array([16.0, 0.0]))


def test_stripes_without_light_or_in_a_blur_are_refused() -> None:
    with pytest.raises(CalibrationError, match="of the photo only"):
        decode(photos(STRIPES, electrons=1.0))
    with pytest.raises(CalibrationError, match="hardly follows"):
        decode(photos(STRIPES, blur_quads=12.0))


def test_saturated_quads_are_left_out() -> None:
    glint = np.full(FRAME, 0.5)
    glint[90:110, 140:160] = 1.0
    found = decode(photos(STRIPES, texture=glint, full_e=15_000.0))
    assert not found.valid[95:105, 145:155].any()
    assert found.valid[MIDDLE].mean() > 0.9
    assert np.percentile(np.hypot(*error(found).T), 99.0) < 0.5


def test_photos_in_another_order_are_noticed() -> None:
    with pytest.raises(CalibrationError):
        fit_decoded_quads(decode(photos(STRIPES[4:] + STRIPES[:4])), SIZE, "projector")


@pytest.mark.long
@pytest.mark.parametrize("base_px", [2, 4])
def test_pictures_of_xor_codes_have_no_wide_stripes(base_px: int) -> None:
    code = XorCode("projector", (1024, 768), base_px)
    assert len(code.shown(1)) == 40
    for line in code.lines(0):
        runs = np.diff(np.flatnonzero(np.diff(line.astype(np.int8)) != 0))
        assert runs.max() <= 2 * base_px
    small = XorCode("projector", SIZE, base_px)
    found = decode_xor(photos(small.shown(1), blur_quads=0.4), small)
    assert np.mean(np.abs(found.panel_px - TRUE)[found.valid & MIDDLE] > 1.0) < 0.02


def test_a_covered_code_is_refused() -> None:
    code = XorCode("projector", SIZE)
    with pytest.raises(CalibrationError, match="of the photo only"):
        decode_xor(photos(code.shown(1), electrons=1.0), code)
