"""Samples that do not follow the light: dead ones, stuck ones, and full ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.sensor.cells import CellMap
from pdcd.sensor.dead import (
    can_tell_samples,
    find_always_full_samples,
    find_dead_samples,
    find_full_level,
    find_stuck_samples,
    mark_full_samples,
)
from pdcd.sensor.dng import write_dng
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import RawFrame, read_raw

SHAPE = (40, 60)
BODY = load_profile("mono")
BLACK, WHITE = BODY.black_dn, BODY.white_dn
Samples = NDArray[np.uint16]


def photo(folder: Path, samples: Samples, cfa: str | None = None) -> RawFrame:
    path = folder / "a.dng"
    write_dng(path, samples, cfa=cfa, black=BLACK, white=WHITE, iso=100, exposure_s=1.0, model="a")
    return read_raw(path, saturation_dn=BODY.saturation_dn(100))


def lit(light: float = 2000.0) -> Samples:
    """A card of even light, with the noise of photons and of the reading."""
    noise = np.random.default_rng(1).standard_normal(SHAPE)
    row = BODY.row(100)
    light_e = light * row.gain_e_per_dn
    noise *= np.sqrt(light_e + row.read_noise_e**2) / row.gain_e_per_dn
    return np.round(np.clip(BLACK + light + noise, 0, WHITE)).astype(np.uint16)


def places(found: NDArray[np.bool_]) -> list[list[int]]:
    return np.argwhere(found).tolist()


def dead_sample(samples: Samples) -> list[list[int]]:
    samples[7, 9] = BLACK + 2
    return [[7, 9]]


def sample_at_the_edge(samples: Samples) -> list[list[int]]:
    samples[0, 9] = samples[20, SHAPE[1] - 1] = BLACK
    return [[0, 9], [20, SHAPE[1] - 1]]


def two_columns(samples: Samples) -> list[list[int]]:
    samples[:, 30:32] = BLACK
    return [[row, column] for row in range(SHAPE[0]) for column in (30, 31)]


def a_row_half_in_the_dark(samples: Samples) -> list[list[int]]:
    """What lies in the dark is dead, too, though no neighbour tells."""
    samples[:, 40:] = BLACK + 3
    samples[5] = BLACK
    return [[5, column] for column in range(SHAPE[1])]


def where_the_light_ends(samples: Samples) -> list[list[int]]:
    """Rows and columns at the edge of the frame that lie beside the field."""
    samples[:2] = samples[-1:] = BLACK
    samples[:, :1] = BLACK
    return []


def ink(samples: Samples) -> list[list[int]]:
    """Black ink sends 3 % back, and a lens spreads more than that over a line of two samples."""
    samples[10:30, 20:22] = BLACK + 60
    return []


def a_black_field(samples: Samples) -> list[list[int]]:
    samples[10:30, 20:24] = BLACK
    return []


def dim_light(samples: Samples) -> list[list[int]]:
    samples[:] = lit(100.0)
    samples[7, 9] = BLACK
    return []


@pytest.mark.parametrize(
    "change",
    [dead_sample, sample_at_the_edge, two_columns, a_row_half_in_the_dark,
     where_the_light_ends, ink, a_black_field, dim_light],
)  # fmt: skip
def test_the_dead_are_dark_between_lit_ones(
    change: Callable[[Samples], list[list[int]]], tmp_path: Path
) -> None:
    samples = lit()
    wanted = change(samples)
    assert places(find_dead_samples(photo(tmp_path, samples), BODY, 100)) == wanted


def test_a_quad_is_dead_with_any_of_its_samples(tmp_path: Path) -> None:
    samples = lit()
    samples[12, 21] = BLACK  # G1 of the quad in row 6 and column 10
    assert places(find_dead_samples(photo(tmp_path, samples, "RGGB"), BODY, 100)) == [[6, 10]]


def test_a_frame_without_them_says_no_more_of_them(tmp_path: Path) -> None:
    samples = lit()
    samples[3, 3] = WHITE
    frame = photo(tmp_path, samples)
    marks = np.zeros(SHAPE, np.bool_)
    marks[7, 9] = True
    assert places(frame.without(marks).saturated) == [[3, 3], [7, 9]]
    assert places(frame.saturated) == [[3, 3]]


@pytest.mark.parametrize(("beside", "alone"), [(BLACK, True), (1900, True), (2200, False)])
def test_a_stuck_sample_is_saturated_by_itself(beside: int, alone: bool, tmp_path: Path) -> None:
    samples = np.full(SHAPE, BLACK, np.uint16)
    samples[7, 9], samples[8, 10] = WHITE, beside
    found = find_stuck_samples(photo(tmp_path, samples), BODY.saturation_dn(100))
    assert places(found) == [[7, 9]] * alone
    none: Any = find_stuck_samples(photo(tmp_path, lit()), BODY.saturation_dn(100))
    assert not none.any()


def test_a_sample_is_white_whatever_it_sees_if_it_is_so_in_the_dark(tmp_path: Path) -> None:
    """One that is stuck, a glint that is full in the first photo only, and one that is full in all
    of them but never lies in the dark."""
    photos = []
    for number, beside in enumerate((1500, BLACK)):
        samples = np.full(SHAPE, beside, np.uint16)
        samples[7, 9] = samples[2, 3] = WHITE
        samples[2, 4] = 1500
        samples[12, 13] = WHITE if number == 0 else 1500
        photos.append((photo(tmp_path, samples), BODY.saturation_dn(100)))
    full = photos[0][0].saturated
    assert places(full) == [[2, 3], [7, 9], [12, 13]]
    assert places(find_always_full_samples(full, photos)) == [[7, 9]]
    assert not find_always_full_samples(full, photos[:1]).any()


@pytest.mark.parametrize(("side", "fine"), [(1, False), (3, False), (4, True), (20, True)])
def test_neighbours_tell_where_cells_are_larger(side: int, fine: bool) -> None:
    cells = CellMap.block((3, 4), (3 * side, 4 * side))
    assert can_tell_samples(cells) == fine


def full_at(samples_e: NDArray[np.float64], full_e: float, iso: int) -> Samples:
    """Electrons of light, with their noise, in a sensor that holds fewer than its profile says."""
    rng, row = np.random.default_rng(2), BODY.row(iso)
    held = np.minimum(rng.poisson(samples_e), full_e)
    held = held + row.read_noise_e * rng.standard_normal(held.shape)
    return np.clip(np.rint(BLACK + held / row.gain_e_per_dn), 0, WHITE).astype(np.uint16)


RAMP = np.linspace(0.02, 1.5, 40_000).reshape(200, 200)


@pytest.mark.parametrize("iso", [100, 800])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.85])
def test_samples_are_full_far_below_what_the_profile_says(
    tmp_path: Path, share: float, iso: int
) -> None:
    row = BODY.row(iso)
    full_e = share * BODY.saturation_dn(iso) * row.gain_e_per_dn
    frame = photo(tmp_path, full_at(full_e * RAMP, full_e, iso))
    level = find_full_level(frame, BODY, iso)
    assert level is not None and 0.9 * full_e < level * row.gain_e_per_dn < full_e
    full = mark_full_samples(frame, level).saturated
    assert full[RAMP > 1.2].mean() > 0.999 and not full[RAMP < 0.7].any()


@pytest.mark.parametrize("top", [0.0, 0.01, 0.3, 0.8])
def test_light_that_ends_at_its_own_noise_is_not_full(tmp_path: Path, top: float) -> None:
    """A ramp, a card that is lit evenly and one with a glint, at any level."""
    full_e = BODY.saturation_dn(100) * BODY.row(100).gain_e_per_dn
    even, glint = np.full(RAMP.shape, top), np.full(RAMP.shape, top)
    glint[:5, :5] = 0.9
    for light in (top * RAMP / RAMP.max(), even, glint):
        frame = photo(tmp_path, full_at(full_e * light, full_e, 100))
        assert find_full_level(frame, BODY, 100) is None


def test_an_even_wall_without_noise_is_not_full(tmp_path: Path) -> None:
    samples = np.minimum(BLACK + 3000.0 * RAMP, BLACK + 2000.0).astype(np.uint16)
    assert find_full_level(photo(tmp_path, samples), BODY, 100) is None
