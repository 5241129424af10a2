"""How much strips are trusted beside their noise: as far as they fit, and no further."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.timing.programmes import SETS, make_pulse_strips, make_strip_sequence
from pdcd.calibration.timing.strips import StripReadings
from pdcd.calibration.timing.timing_fit import FLAT, FLOOR, LEAST_FLOORS, FittedTiming, TimingFitter
from pdcd.calibration.timing.timing_model import PanelTimes, StripModel
from pdcd.panels.map import Map
from tests.unit.calibration.pulsed_bench import REFRESH_S, Bench, TruePanel

pytestmark = pytest.mark.whole

Floats = NDArray[np.float64]

BANDS = 4
ELECTRONS = 1e9
"""Of a white strip in a band: a large frame."""
TAUS_S = np.array([0.0011, 0.0014, 0.0071, 0.0012])
"""A projector that is much faster than its mask: the hard case."""
LAGS_S = 0.0097 - 0.0003 * (np.arange(BANDS) + 0.5) / BANDS


def model_of(beside: float, seed: int) -> tuple[StripModel, PanelTimes]:
    """Four photos of strips with noise, and an error beside it that is a share of the stated one;
    and the truth."""
    maps = Map.filling((256, 192)), Map.filling((320, 240))
    panels = TruePanel(0.002, 0.003), TruePanel(0.004, 0.008)
    on = Bench(maps[0], maps[1], Map.filling((192, 128)), *panels)
    log = on.log(
        make_strip_sequence("strips", make_pulse_strips(maps[0]), *maps, white=False, periods=3)
    )
    bands = (np.arange(BANDS) + 0.5) / BANDS
    none = np.zeros((BANDS, len(SETS[0])))
    blank = StripReadings(none, none, bands, 1.0 / BANDS, SETS[0])
    model = StripModel([blank] * 4, [log] * 4, REFRESH_S)
    true = PanelTimes(TAUS_S, np.array([2e-3, 3e-3]), LAGS_S - model.apart_s)
    light = model.shape(true)
    rng = np.random.default_rng(seed)
    noise = np.sqrt(light * (1.0 + light) / ELECTRONS)
    off = np.sqrt(noise**2 + beside**2 * ((FLAT * light) ** 2 + FLOOR**2))
    read = light + off * rng.normal(size=light.shape)
    model.readings = [
        replace(blank, value=value, sigma=sigma) for value, sigma in zip(read, noise, strict=True)
    ]
    return model, true


def solved(model: StripModel, start: PanelTimes) -> FittedTiming:
    """As far as one more round changes nothing to speak of."""
    found = TimingFitter(model).solve(start)
    for _ in range(4):
        found = TimingFitter(model, found.floors).solve(found.times)
    return found


@pytest.mark.parametrize("beside", [0.1, 0.8])
def test_the_error_beside_noise_is_found_from_what_does_not_fit(beside: float) -> None:
    found = [solved(*model_of(beside, seed)).floors for seed in range(3)]
    assert np.mean(found) == pytest.approx(beside, rel=0.1)


def test_strips_are_never_trusted_less_than_stated_nor_without_end() -> None:
    worse = solved(*model_of(3.0, 0))
    assert worse.floors == 1.0
    assert worse.chi2 == pytest.approx(9.0, rel=0.25)  # of what was stated, not of what was found
    better = solved(*model_of(0.0, 0))
    assert LEAST_FLOORS <= better.floors < 0.06
    assert better.chi2 < 0.05


def test_a_fast_projector_is_told_from_a_late_mask_where_strips_fit_well() -> None:
    """Errors over three sets of photos; what the faint strips say decides."""
    errors: list[list[Floats]] = [[], []]
    for seed in range(3):
        model, true = model_of(0.0, seed)
        for kind, found in enumerate((TimingFitter(model).solve(true), solved(model, true))):
            errors[kind].append(found.times.taus_s[:2] / TAUS_S[:2] - 1.0)
    stated, weighed = (float(np.sqrt(np.mean(np.square(kind)))) for kind in errors)
    assert weighed < 0.75 * stated
