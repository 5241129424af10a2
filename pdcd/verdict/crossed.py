"""Whether the codes of both panels meet in time, from the differences between parts of a photo.

Where the mask is later or earlier than believed, all over or in some rows, each of its codes meets
the one before or after it on the projector as well. For how long a cell is then lit through its own
mask differs from part to part with the order of its codes, which is known. The scene is the same in
all parts, and the chance of codes follows another order. So direct light that gets past the codes
is measured to a few thousandths, however little is known of the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.pictures.combine import FEWEST_TELLING_PARTS, find_telling_photo
from pdcd.pictures.slow_light import fit_part_differences, number_patches
from pdcd.probing.deviation import weight_s
from pdcd.verdict.evidence import Evidence, compute_rms
from pdcd.verdict.placement import LightSample

_SURE = 4.0
"""The RMS of light over that of chance from which it counts as getting past the codes: where they
meet, it was up to 2.9 on 9 x 12 cells, and up to 2.2 on more."""
_MOST = 4.0
"""Such light over all direct light, from which it must be something else: so much would pass if no
codes blocked any, as these let a quarter of the indirect light through."""
_NODES = 5
"""Nodes, down the field or across it, between which the lateness of panels is interpolated."""


@dataclass(frozen=True)
class CrossedLight:
    """Direct light that gets past the codes: as a share of all direct light, and its RMS over that
    of the answer."""

    lost: float
    share: float


def measure_crossed_light(
    seen: Evidence, single: Sequence[LightSample], direct_share: float
) -> CrossedLight | None:
    """Measured from the parts of a photo without direct light; 0 where codes meet, None where there
    are too few parts, or where nothing shows how much direct light there is. For the verdict on
    panels. single : photos of one code each through an open mask, which stand in for a white
    photo. direct_share : of all light, measured without the mask; 0 where it was not."""
    white = [p for p in seen.decoded.recipe.photos if p.wanted.uniform == (1.0, 1.0)]
    photo = find_telling_photo(seen.decoded.recipe)
    if photo is None:
        return None
    samples = {
        name: seen.sample([(1.0, name)])
        for sign, name in photo.shots
        if sign > 0.0 and name in seen.decoded.crossed
    }
    weights_s = {name: weight_s(one.realised, photo.wanted) for name, one in samples.items()}
    names = [name for name, weight in weights_s.items() if weight > 0.0]
    if len(names) < FEWEST_TELLING_PARTS:
        return None
    light, believed, late, early = (
        np.stack([one / weights_s[name] for name, one in zip(names, each, strict=True)])
        for each in (
            [samples[name].light for name in names],
            [samples[name].realised.coaxial for name in names],
            *([seen.decoded.crossed[name][side] for name in names] for side in (0, 1)),
        )
    )
    whole = [seen.sample(white[-1].shots)] if white else single
    if not whole:
        return None
    full = np.sum([one.realised.coaxial for one in whole], axis=0)
    total = np.sum([one.light for one in whole], axis=0)
    all_light = np.divide(total, full, out=np.full(full.shape, np.nan), where=full > 0.0)
    if white and photo.wanted.uniform == (0.0, 1.0):
        direct = _subtract_indirect_light(all_light, light, believed)
    else:
        direct = direct_share * all_light
    return compute_crossed_light(light, believed, (late, early), direct, seen.cells.grid)


def _subtract_indirect_light(all_light: Floats, light: Floats, believed: Floats) -> Floats:
    """Direct light of cells, (N,): what is left of all light, (N,), without that of parts, and
    without what is believed to get past the codes; `light` and `believed` as below."""
    left = np.maximum(all_light - light.mean(axis=0), 0.0)
    return np.asarray(left / (1.0 - believed.mean(axis=0)))


def compute_crossed_light(
    light: Floats,
    believed: Floats,
    crossed: tuple[Floats, Floats],
    direct: Floats,
    grid: tuple[int, int],
) -> CrossedLight | None:
    """The same from the light of P parts on N cells.

    light : (P, N), of parts in units of the light that is wanted, NaN where it is not known.
    believed : (P, N), share of the direct light that is believed to get past the codes. crossed :
    how much more would if the mask were late, and if it were early. direct : (N,).
    """
    known = np.isfinite(direct - light.mean(axis=0))
    light, believed, direct = light[:, known], believed[:, known], direct[known]
    light = light - believed * direct
    answer, all_direct = compute_rms(light.mean(axis=0)), compute_rms(direct)
    if not (answer > 0.0 and all_direct > 0.0):
        return None
    # Panels that set their rows one after another are late in some and early in others.
    past = max(
        _measure_past(
            light,
            [side[:, known] * direct * near[known] for side in crossed for near in nodes],
            number_patches(grid)[known],
        )
        for nodes in _place_nodes(grid)
    )
    past /= all_direct
    past = past if past < _MOST else 0.0
    # This light is missing in the direct light that was computed above.
    return CrossedLight(past / (1.0 + past), past * all_direct / answer)


def _measure_past(light: Floats, more: Sequence[Floats], patch: NDArray[np.intp]) -> float:
    """RMS over cells of the light that varies with parts as some patterns do; 0 if chance may have
    made it. light, and each pattern: (P, N). patch : (N,)."""
    times, covariance = fit_part_differences(light, more, patch)
    mean = np.stack([one.mean(axis=0) for one in more])
    power = mean @ mean.T / mean.shape[1]
    found, chance = float(times @ power @ times), float(np.sum(power * covariance))
    return float(np.sqrt(found)) if found > _SURE**2 * chance else 0.0


def _place_nodes(grid: tuple[int, int]) -> Iterator[list[Floats]]:
    """How near each cell is to nodes down the field, and to nodes across it: 1 at a node, and 0
    from the next one on; a list of (N,) each."""
    for at, length in zip(np.indices(grid), grid, strict=True):
        place = (at.ravel() + 0.5) / length * (_NODES - 1)
        yield [np.maximum(1.0 - np.abs(place - node), 0.0) for node in range(_NODES)]
