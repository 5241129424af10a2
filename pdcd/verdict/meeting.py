"""Whether the codes of both panels meet in time: the direct light that photos of codes show is
compared with the direct light that is there whatever the mask does.

The realised matrix is computed from the believed times of the panels. If the mask is late or slow,
the matrix has codes meet while direct light gets past them. That light is missing in the picture of
direct light, and added to that of indirect light, for all points and in all parts alike. There are
three measurements of it:

- *the differences between parts* (`pdcd.verdict.crossed`), to a few thousandths of the direct
  light, where there are parts;
- *single codes through an open mask*, as of a pilot: a cell is bright when its own projector cell
  is. They measure direct light to a few hundredths;
- *blocks on the projector*, which stand still (`pdcd.pictures.misplaced`). They count light from
  near as direct, so that they measure it to a fifth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdcd.arrays import Floats
from pdcd.sensor.cells import CellMap
from pdcd.verdict.causes import Cause, Grade, VerdictFinding, judge
from pdcd.verdict.crossed import measure_crossed_light
from pdcd.verdict.evidence import Evidence, compute_rms
from pdcd.verdict.placement import LightSample

_LEAST_THERE = 0.1
"""Least share of direct light for photos to measure how much of it is lost."""
_LEAST_LOST = 0.03
"""Share of it that may seem lost where codes meet, beyond chance. It was up to 0.03 in front of wax
with quarter windows, which is less than is doubtful there, else 0.015."""
_BLOCKS_UNSURE = 0.2
"""The same for the measurement by blocks, in addition: 0.16 in front of milk."""
_HOPELESS = 0.5
"""Lost share from which photos of codes no longer measure how much direct light there is."""
_CHANCE = 6.0
"""Direct light over its standard deviation from which it counts as present."""
_SIGMAS = 2.0
"""Standard deviations by which the measured direct light may be off."""


@dataclass(frozen=True)
class DirectLight:
    """Direct light over all light: what is there, what photos of codes show of it, and the relative
    error of the former."""

    there: float
    shown: float
    unsure: float


def judge_meeting(
    seen: Evidence,
    coded: Floats,
    single: Sequence[LightSample],
    placed: list[VerdictFinding],
) -> list[VerdictFinding]:
    """Whether photos of codes show all the direct light that is there; else what was found of the
    places of panels; else whether wrong times would show.

    coded : (N,), its shares by photos of codes, NaN where they cannot be computed. single : photos
    of one code each through an open mask, none or at least two. placed : the findings on places,
    which wrong times explain.
    """
    there = _find_direct_share(seen, single)
    light = _compare_direct_light(seen, coded, single)
    found = [] if light is None else _judge_lost_light(seen, light)
    by_parts = measure_crossed_light(seen, single, there)
    if by_parts is None:
        return found or placed or _judge_unseen_times(seen, there, light)
    if not (found and found[0].grade is Grade.BAD):
        found = judge(Cause.CODES_APART, by_parts.share, lost=by_parts.lost, elsewhere="") or found
    return found or placed


def _judge_unseen_times(
    seen: Evidence, there: float, light: DirectLight | None
) -> list[VerdictFinding]:
    """What panels would do to the answer that switch at other times than configured, as far as
    nothing shows it; nothing where their times are known. there : direct light over all light, 0
    where it was not measured. light : what photos of codes show of it, None where they do not."""
    planned = [seen.planned[name] for name in seen.names if name in seen.planned]
    if seen.record.times_known or all(shot.white or shot.of_leaks for shot in planned):
        return []
    lost = 1.0 if light is None else light.unsure + _LEAST_LOST
    return judge(Cause.TIMES_UNSURE, _share_of_answer(seen, there or 1.0, lost), lost=lost)


def _find_direct_share(seen: Evidence, single: Sequence[LightSample]) -> float:
    """Direct light over all light, as it is measured without the mask's codes; 0 where it was not.
    Arguments of `judge_meeting`."""
    none = np.zeros(seen.cells.grid[0] * seen.cells.grid[1])
    light = compare_with_single_codes(none, single, measure_own_part(seen.cells))
    if light is not None:
        return light.there
    look = seen.record.panels
    return 0.0 if look is None else look.direct


def _compare_direct_light(
    seen: Evidence, coded: Floats, single: Sequence[LightSample]
) -> DirectLight | None:
    """Direct light measured whatever the mask does, and what codes show of it; arguments of
    `judge_meeting`."""
    look = seen.record.panels
    light = compare_with_single_codes(coded, single, measure_own_part(seen.cells))
    if light is None and look is not None:
        light = compare_with_blocks(coded, look.direct)
    return light


def _judge_lost_light(seen: Evidence, light: DirectLight) -> list[VerdictFinding]:
    """The finding on the direct light that codes do not show, if there is one."""
    look = seen.record.panels
    lost, placed = 1.0 - light.shown / light.there, look is not None and look.mask is not None
    if placed:
        lost = _find_unexplained(seen, lost)
    sure = min(lost - light.unsure, 1.0)
    if sure < _LEAST_LOST:
        return []
    lost = min(lost, 1.0)
    return judge(
        Cause.CODES_APART,
        _share_of_answer(seen, light.there, lost),
        Cause.CODES_APART.value.grade(_share_of_answer(seen, light.there, sure)),
        lost=lost,
        elsewhere="" if placed else ", or elsewhere",
    )


def list_single_codes(seen: Evidence, names: Sequence[str]) -> list[LightSample]:
    """Photos of one code each. They have no black exposures of their own: the room's light is
    subtracted as another shot shows it, if there is one."""
    samples = [seen.sample([(1.0, name)]) for name in names]
    for name, shot in seen.planned.items():
        if shot.primal_black and not shot.dual_black and name in seen.decoded.shots:
            black = seen.sample([(1.0, name)])
            opened = black.realised.open_s
            rate = np.divide(black.light, opened, out=np.zeros(opened.size), where=opened > 0.0)
            return [replace(s, light=s.light - rate * s.realised.open_s) for s in samples]
    return samples


def compare_with_single_codes(
    coded: Floats, single: Sequence[LightSample], own_part: float
) -> DirectLight | None:
    """The direct light of bright cells by photos of single codes, compared with that by `coded`
    (N,), both with the same weights of cells; None where they cannot measure it. own_part : share
    of the light of a cell's pixels that comes from the cell itself."""
    if len(single) < 2:
        return None
    light = np.stack([s.light for s in single])
    codes = np.stack([s.realised.coaxial for s in single])
    mean, level = light.mean(axis=0), codes.mean(axis=0)
    known = np.isfinite(coded) & np.isfinite(mean) & (mean > 0.0) & (level > 0.0)
    if not known.any():
        return None
    mean, shown = mean[known], codes[:, known] / level[known] - 1.0
    weights = mean * shown**2
    power = float(weights.sum())
    if not power > 0.0:
        return None
    seen = light[:, known] - mean
    there = float((seen * shown).sum()) / power
    sigma = float(np.sqrt((((seen - there * mean * shown) * shown) ** 2).sum())) / power
    if there < max(_LEAST_THERE, _CHANCE * sigma):
        return None
    kept = float((weights * coded[known]).sum()) / power
    return DirectLight(there / own_part, kept, _SIGMAS * sigma / there)


def compare_with_blocks(coded: Floats, there: float) -> DirectLight | None:
    """The mean of shares `coded` (N,), and what is `there` by blocks, which stand still."""
    known = np.isfinite(coded)
    if there < _LEAST_THERE or not known.any():
        return None
    return DirectLight(there, float(coded[known].mean()), _BLOCKS_UNSURE)


def measure_own_part(cells: CellMap) -> float:
    """Share of the light of pixels with their centre in a cell that comes from that cell: pixels at
    its edges see the next one, too."""
    rows, cols = cells.grid
    half = 0.5 * float(np.sqrt(cells.quad_cells))
    at = cells.centres[cells.known] * (cols, rows)
    if not at.size:
        return 1.0
    beside = at - np.floor(at)
    over = np.maximum(half - beside, 0.0) + np.maximum(half - (1.0 - beside), 0.0)
    return float(np.mean(np.prod(1.0 - np.minimum(over / (2.0 * half), 0.5), axis=-1)))


def _find_unexplained(seen: Evidence, lost: float) -> float:
    """What is lost beyond the light that goes through wrong cells of a misplaced mask, which has a
    row of its own."""
    from pdcd.pictures.lost_direct import estimate_lost_direct  # few runs have looked

    kept = 1.0 - estimate_lost_direct(seen.record, seen.window).mean
    return 1.0 - (1.0 - lost) / kept if kept > 0.5 else 0.0


def _share_of_answer(seen: Evidence, there: float, lost: float) -> float:
    """RMS of the direct light that is lost over that of the answer. Where no photo of all light
    shows how much that is, it is over the direct light that is left."""
    answer = compute_rms(seen.inside(seen.decoded.answer.image))
    white, direct = (seen.pictures.get(name) for name in ("white", "direct"))
    if white is None or not answer > 0.0:
        return lost / (1.0 - lost) if lost < 1.0 else np.inf
    light = there * compute_rms(seen.inside(white.image))
    if lost < _HOPELESS and direct is not None:
        light = compute_rms(seen.inside(direct.image)) / (1.0 - lost)
    return lost * light / answer
