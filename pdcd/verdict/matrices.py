"""The verdict on probing matrices as the panels realised them: on wrong weights, torn windows, and
light that got through although it was to be blocked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Bools, Floats, Indices
from pdcd.pictures.weights import (
    RealisedShot,
    find_shut_cells,
    find_unlit_cells,
    is_divided_by_row,
    sum_realised_matrices,
)
from pdcd.probing.convolved import SameRowPart
from pdcd.probing.deviation import compute_row_deviations, row_weights_s, weight_s
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import FullPart, Grid, MatchPart, MatrixPart, WantedMatrix
from pdcd.recipes.recipe import Combination, Extremes, RecipePhoto
from pdcd.runs.record import ShotRecord
from pdcd.verdict.causes import Cause, VerdictFinding, judge
from pdcd.verdict.evidence import Evidence
from pdcd.words import NormaliseName

_TOGETHER = 1
"""Cells by which the offset between partners may differ from that between the neighbours."""
_NO_WEIGHT = 1e-9
"""Weight below which it counts as none."""
_FEWEST_COMPARED = 2
"""Least number of parts from which their common error can be separated from chance."""
_LEAST_SHOWN = 0.05
"""Least share of the direct light that a picture of it is taken to show."""


def judge_matrices(seen: Evidence) -> Iterator[VerdictFinding]:
    """All findings on the matrices of the answer's photos."""
    yield from judge(Cause.TORN, warp_tear_share(seen.photos, seen.records))
    grey = seen.record.grey_unknown
    yield from judge(Cause.GREY_LIGHT, float(len(grey)), panels=" and the ".join(grey))
    for photo in seen.photos:
        one = seen.deviations[photo.name]
        yield from judge(Cause.DIRECT_WEIGHT, abs(one.diagonal_mean), photo=photo.name)
        yield from judge(Cause.PATH_WEIGHTS, one.off_rms, photo=photo.name)
        realised = sum_realised_matrices(photo.shots, seen.panels)
        yield from judge_never_shown(photo.name, realised, photo.wanted)
        parts = [sum_realised_matrices(terms, seen.panels) for terms in _list_parts(seen, photo)]
        common = measure_common_error(realised, parts, photo.wanted)
        yield from judge(Cause.COMMON_WEIGHTS, common, photo=photo.name)
    off = compute_direct_weight_errors(seen.photos, seen.panels, seen.record.normalise)
    for name, wrong in off.items():
        yield from judge(Cause.DIRECT_BY_CELL, wrong, photo=name)
    rule = seen.decoded.recipe.answer
    if "direct" in seen.pictures:
        yield from _judge_direct_left(seen)
    elif not isinstance(rule, Extremes):
        shares = {name: share for share, name in rule}
        if "white" not in seen.pictures:
            yield from _judge_direct_unseen(seen, shares)
        elif "white" not in shares:
            yield from _judge_blocked_left(seen, shares)


def judge_never_shown(
    photo: str, realised: Factors, wanted: WantedMatrix
) -> Iterator[VerdictFinding]:
    """Whether a photo's codes lit and opened all cells that they were to. If not, no part of it
    does, so that the spread of the parts does not show it."""
    unlit, share = find_unlit_cells(realised, wanted)
    yield from judge(Cause.NEVER_LIT, share, photo=photo, cells=_count_cells(unlit))
    shut = find_shut_cells(realised, wanted)
    if shut is not None:
        figure = float(shut.mean())
        yield from judge(Cause.NEVER_OPEN, figure, photo=photo, cells=_count_cells(shut))


def _list_parts(seen: Evidence, photo: RecipePhoto) -> list[Combination]:
    """The shots of each part of a photo, with their signs; sums of single codes have none."""
    parts: dict[int, list[tuple[float, str]]] = {}
    for sign, name in photo.shots:
        if name in seen.planned:
            parts.setdefault(seen.planned[name].part, []).append((sign, name))
    return [tuple(terms) for terms in parts.values()]


def measure_common_error(
    realised: Factors, parts: Sequence[Factors], wanted: WantedMatrix
) -> float:
    """RMS error of weights that all parts of a photo have alike, over all paths except those of
    unknown cells; 0 for a photo without parts, or where their errors compensate each other.

    The mean of B parts with independent errors has 1/B of their mean square. Any excess is common
    to them.
    """
    if len(parts) < _FEWEST_COMPARED:
        return 0.0
    shut = find_shut_cells(realised, wanted)
    known = np.ones(wanted.cells, np.bool_) if shut is None else ~shut
    alone = float(np.mean([_compute_path_error(part, wanted, known) for part in parts]))
    whole = _compute_path_error(realised, wanted, known)
    return float(np.sqrt(max(len(parts) * whole - alone, 0.0) / (len(parts) - 1)))


def _compute_path_error(realised: Factors, wanted: WantedMatrix, known: Bools) -> float:
    """Mean square error of the weights of all paths but the direct one, for `known` cells (N,)."""
    scale = weight_s(realised, wanted)
    if not known.all():
        inner, norm = row_weights_s(realised, wanted)
        scale = float(inner[known].sum()) / max(float(norm[known].sum()), _NO_WEIGHT)
    mean, variance, _ = compute_row_deviations(realised, wanted, scale if scale > 0.0 else 1.0)
    return float(np.mean((mean**2 + variance)[known]))


def _count_cells(cells: Bools) -> str:
    """In words."""
    return f"{np.count_nonzero(cells)} of {cells.size} cells"


def _judge_direct_left(seen: Evidence) -> Iterator[VerdictFinding]:
    """How much of an answer without direct light is direct light, if it is made of one photo and a
    picture shows how much direct light there is."""
    left = find_direct_left(seen)
    if left is None:
        return
    found = judge(Cause.DIRECT_LEFT, left.share, weight=left.weight)
    if found and left.taken_out is not None:
        found = judge(Cause.DIRECT_TAKEN_OUT, left.taken_out)
    yield from found


@dataclass(frozen=True)
class DirectLeft:
    """Direct light in an answer that should have none: its mean weight, and its RMS over that of
    the answer. taken_out : the same where it was subtracted, None where it is still in the picture.
    """

    weight: float
    share: float
    taken_out: float | None


def find_direct_left(seen: Evidence) -> DirectLeft | None:
    """Direct light that the panels let through as they switch, or between cells, in an answer of
    one photo without direct light; None for other answers, or where no picture shows how much
    direct light there is. For the verdict and the error budget."""
    if len(seen.photos) != 1 or "direct" not in seen.pictures:
        return None
    (photo,) = seen.photos
    if photo.wanted.uniform is None or photo.wanted.uniform[0] != 0.0:
        return None
    there, answer = (seen.inside(p.image) for p in (seen.pictures["direct"], seen.decoded.answer))
    mean = abs(seen.deviations[photo.name].diagonal_mean)
    weight = max(mean, _weight_at_borders(seen, photo))
    # The direct light that is left in this picture is missing in the picture of direct light.
    share = compute_light_share(weight, there / max(1.0 - mean, _LEAST_SHOWN), answer)
    taken_out = None
    if seen.decoded.takes_out(photo, seen.record.normalise):
        taken_out = compute_light_share(weight, there, answer)
    return DirectLeft(weight, share, taken_out)


def compute_light_share(weight: float, light: Floats, answer: Floats) -> float:
    """RMS of light with this weight over that of the answer, (n, C) each, where both are known."""
    known = np.isfinite(light) & np.isfinite(answer)
    power = float(np.sum(answer[known] ** 2))
    return weight * float(np.sqrt(np.sum(light[known] ** 2) / power)) if power > 0.0 else 0.0


def _weight_at_borders(seen: Evidence, photo: RecipePhoto) -> float:
    """RMS over the quads of the weight of direct light that gets through between cells.

    This light lies along the borders of cells, in lines that are one quad wide or, where quads are
    finer than that, as wide as the distance of the panels' borders.
    """
    apart = seen.decoded.apart_in(photo)
    quads = max(int(np.count_nonzero(seen.cells.known)), 1)
    quad = float(np.sqrt(seen.decoded.recipe.target.cells / quads))
    return apart / float(np.sqrt(max(min(2.0 * quad, 1.0), apart)))


def _judge_blocked_left(seen: Evidence, shares: Mapping[str, float]) -> Iterator[VerdictFinding]:
    """How much is left of light that was to be blocked because of its depth, or its row.

    Not where windows cut cells: a weight between cells then says nothing of direct light, which
    goes from point to point.
    """
    if any(shot.window != "whole" for shot in seen.record.shots):
        return
    if not any(list_blocked_parts(photo.wanted) for photo in seen.photos):
        return
    weight = 0.0
    for photo in seen.photos:
        realised = sum_realised_matrices(photo.shots, seen.panels)
        full_s = seen.deviations[photo.name].weight_s
        weight += shares[photo.name] * compute_blocked_weight(realised, photo.wanted, full_s)
    weight = abs(weight)
    white, answer = (seen.inside(p.image) for p in (seen.pictures["white"], seen.decoded.answer))
    # The light that is left in this picture is missing in the difference.
    blocked = (white - answer) / max(1.0 - weight, _LEAST_SHOWN)
    share = compute_light_share(weight, blocked, answer)
    yield from judge(Cause.BLOCKED_LEFT, share, weight=weight)


def _judge_direct_unseen(seen: Evidence, shares: Mapping[str, float]) -> Iterator[VerdictFinding]:
    """Direct light in an answer that should have none in some cells, where no photo shows how much
    direct light there is. On an off-axis bench direct light takes other paths."""
    if not seen.photos:
        return
    wanted, got = np.zeros((2, seen.photos[0].wanted.cells))
    for photo in seen.photos:
        realised = sum_realised_matrices(photo.shots, seen.panels)
        wanted += shares[photo.name] * photo.wanted.diagonal()
        got += shares[photo.name] * realised.coaxial / seen.deviations[photo.name].weight_s
    none = np.abs(wanted) < _NO_WEIGHT
    yield from judge(Cause.DIRECT_UNSEEN, float(np.abs(got[none]).sum() / none.size))


def warp_tear_share(photos: Iterable[RecipePhoto], shots: Sequence[ShotRecord]) -> float:
    """Share of cells that share windows with others whose partners lie elsewhere: the largest of
    these photos; 0 where all their `shots` were shown through whole windows. Photos that keep other
    light, too, lose little, and do not count.

    A quarter window opens for the code of a projector cell that reaches beyond it, and is shared by
    four cells of the mask. That is right where neighbours are matched with neighbours, as by a
    shift or by the map of a surface. Where a warp tears, each of the four sees light of the others'
    partners.
    """
    windows = {shot.name: shot.window for shot in shots}
    share = 0.0
    for photo in photos:
        wanted = photo.wanted
        alone = all(isinstance(part, MatchPart) for _, part in wanted.parts)
        parted = any(windows.get(name, "whole") != "whole" for _, name in photo.shots)
        if alone and parted and wanted.matched is not None:
            share = max(share, count_torn_cells(wanted.matched, wanted.grid))
    return share


def count_torn_cells(partner: Indices, grid: Grid) -> float:
    """Share of the cells with a partner, (N,), next to one whose partner lies elsewhere."""
    rows, cols = grid
    there = (partner >= 0).reshape(grid)
    moved = np.array(np.divmod(partner.reshape(grid), cols)) - np.indices(grid)
    apart = np.zeros(grid, dtype=np.bool_)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = slice(0, rows - down), slice(max(0, -right), cols - max(0, right))
        next_ = slice(down, rows), slice(max(0, right), cols + min(0, right))
        differ = np.abs(moved[:, *here] - moved[:, *next_]).max(axis=0, initial=0) > _TOGETHER
        differ &= there[here] & there[next_]
        apart[here] |= differ
        apart[next_] |= differ
    return float(np.count_nonzero(apart & there)) / max(int(there.sum()), 1)


def list_blocked_parts(wanted: WantedMatrix) -> list[MatrixPart]:
    """The paths that a photo is to block: of matched cells, or of rows. Direct light of an off-axis
    bench takes one of these paths; which one is not known."""
    return [p for w, p in wanted.parts if w < 0.0 and isinstance(p, MatchPart | SameRowPart)]


def compute_blocked_weight(realised: Factors, wanted: WantedMatrix, weight_s: float) -> float:
    """Mean weight in a photo of its `list_blocked_parts`, 0 where it has none.

    weight_s : of a path with a wanted weight of 1, in seconds.
    """
    own = np.arange(wanted.cells)
    got = paths = 0.0
    for part in list_blocked_parts(wanted):
        diagonal = part.entries(own)
        through = np.einsum("rn,rn->n", realised.left, part.others(realised.right))
        got += float(np.sum(through + diagonal * realised.coaxial))
        paths += float(np.sum(part.others(np.ones((1, wanted.cells))) + diagonal))
    return got / (paths * weight_s) if paths else 0.0


def compute_direct_weight_errors(
    photos: Sequence[RecipePhoto], panels: Mapping[str, RealisedShot], normalise: NormaliseName
) -> dict[str, float]:
    """How far the direct weights of cells are off, over the wanted ones, by photo. Only of photos
    that are scaled by one number because of direct light alone, of those that keep a share of it
    beside other matched cells, and of an answer that is one photo of any weights."""
    found = {}
    for photo in photos:
        wanted = photo.wanted.diagonal()
        power = float(np.mean(wanted**2))
        scaled = photo.wanted.by_direct and not photo.wanted.by_light
        alone = not photo.wanted.others(np.ones((1, wanted.size))).any()
        full = [w * part.matrix for w, part in photo.wanted.parts if isinstance(part, FullPart)]
        if full and len(photos) == 1:  # compared with all wanted weights if hardly any are direct
            power, scaled = max(power, float(np.mean(full[0] ** 2))), power > 0.0
        elsewhere = photo.wanted.matched is not None
        # Cells whose partner lies beyond the field have no weight at all.
        counts = np.mean(wanted > 0.0) > 0.5 if elsewhere else scaled or alone
        if not counts or not power > 0.0:
            continue
        if is_divided_by_row(photo, panels, normalise):
            continue
        realised = sum_realised_matrices(photo.shots, panels)
        off = realised.coaxial / weight_s(realised, photo.wanted) - wanted
        found[photo.name] = float(np.sqrt(np.mean(off**2) / power))
    return found
