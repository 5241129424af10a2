"""Do the codes of both panels meet in time? Direct light that photos of codes show, against direct
light that is there whatever the mask does.

The realised matrix goes by what is believed of the panels' times. Of a mask that is late or slow it
says that codes meet, while direct light gets past them: it is missing in the picture of direct
light, and added to that of indirect light, for all points and in all parts alike. What tells it:

- *how parts differ* (`pdcd.verdict.crossed`), to a few thousandths of it, where there are parts;
- *single codes through an open mask*, as of a pilot: a cell is bright when its own projector cell
  is. They tell direct light to a few hundredths;
- *blocks on the projector*, which stand still (`pdcd.pictures.misplaced`). Light from near counts
  as direct there, so that they tell it to a fifth.
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
"""Share of direct light without which photos do not tell how much of it is lost."""
_LEAST_LOST = 0.03
"""Share of it that may seem lost where codes meet, beyond chance. It was up to 0.03 before wax by
quarter windows, which is less than is doubtful there, else 0.015."""
_BLOCKS_UNSURE = 0.2
"""The same by blocks, beyond that: before milk 0.16."""
_HOPELESS = 0.5
"""Share of it that is lost from which photos of codes do not tell any more how much there is."""
_CHANCE = 6.0
"""Direct light over its standard deviation from which it is there."""
_SIGMAS = 2.0
"""Standard deviations of its own that it may be off by."""


@dataclass(frozen=True)
class DirectLight:
    """Direct light over all light: what is there, what photos of codes show of it, and by how much
    the first may be off, over itself."""

    there: float
    shown: float
    unsure: float


def judge_meeting(
    seen: Evidence, coded: Floats, single: Sequence[LightSample]
) -> list[VerdictFinding]:
    """Whether codes keep the direct light apart that is there.

    coded : (N,) its shares by photos of codes, NaN where they do not tell. single : photos of one
    code each through an open mask, none or at least two.
    """
    by_parts = measure_crossed_light(seen)
    found = _compare_direct_light(seen, coded, single)
    if by_parts is None or (found and found[0].grade is Grade.BAD):
        return found
    return judge(Cause.CODES_APART, by_parts.share, lost=by_parts.lost, elsewhere="") or found


def _compare_direct_light(
    seen: Evidence, coded: Floats, single: Sequence[LightSample]
) -> list[VerdictFinding]:
    """The same by direct light that is there whatever the mask does; as of `judge_meeting`."""
    look = seen.record.panels
    light = compare_with_single_codes(coded, single, measure_own_part(seen.cells))
    if light is None and look is not None:
        light = compare_with_blocks(coded, look.direct)
    if light is None:
        return []
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
    """Photos of one code each, which have no black exposures of their own, without the room's light
    by that of another shot, where there is any."""
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
    """The direct light of bright cells by photos of single codes, beside that by `coded` (N,), each
    cell weighing as much; None where they do not tell it. own_part : of the light of a cell's
    pixels, what comes from the cell itself."""
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
    """The mean of shares `coded` (N,) beside what blocks that stand still say is `there`."""
    known = np.isfinite(coded)
    if there < _LEAST_THERE or not known.any():
        return None
    return DirectLight(there, float(coded[known].mean()), _BLOCKS_UNSURE)


def measure_own_part(cells: CellMap) -> float:
    """Of the light of pixels with their centre in a cell, what comes from that cell: pixels at its
    edges see the next one, too."""
    rows, cols = cells.grid
    half = 0.5 * float(np.sqrt(cells.quad_cells))
    at = cells.centres[cells.known] * (cols, rows)
    if not at.size:
        return 1.0
    beside = at - np.floor(at)
    over = np.maximum(half - beside, 0.0) + np.maximum(half - (1.0 - beside), 0.0)
    return float(np.mean(np.prod(1.0 - np.minimum(over / (2.0 * half), 0.5), axis=-1)))


def _find_unexplained(seen: Evidence, lost: float) -> float:
    """What is lost beside what goes through wrong cells of a mask that lies elsewhere, which has a
    row of its own."""
    from pdcd.pictures.lost_direct import estimate_lost_direct  # few runs have looked

    windows = {shot.name: shot.window for shot in seen.record.shots}
    shown = [windows[n] for n in seen.names if n in windows and not seen.planned[n].white]
    kept = 1.0 - estimate_lost_direct(seen.record, next(iter(shown), "whole")).mean
    return 1.0 - (1.0 - lost) / kept if kept > 0.5 else 0.0


def _share_of_answer(seen: Evidence, there: float, lost: float) -> float:
    """RMS of the direct light that is lost over that of the answer; where no photo of all light
    tells how much that is, over the direct light that is left."""
    answer = compute_rms(seen.inside(seen.decoded.answer.image))
    white, direct = (seen.pictures.get(name) for name in ("white", "direct"))
    if white is None or not answer > 0.0:
        return lost / (1.0 - lost) if lost < 1.0 else np.inf
    light = there * compute_rms(seen.inside(white.image))
    if lost < _HOPELESS and direct is not None:
        light = compute_rms(seen.inside(direct.image)) / (1.0 - lost)
    return lost * light / answer
