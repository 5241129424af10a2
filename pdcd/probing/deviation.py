"""How far a realised probing matrix is from the wanted one, and what it must be divided by.

No matrix is evaluated entry by entry. The wanted matrix is a sum of parts that can sum up their own
rows (`pdcd.probing.wanted`), the realised one is ``left.T @ right`` with R rows each: sums over
its rows follow from sums over `right`, sums of squares from ``right @ right.T``. So all of this
takes O(N R^2) time and O(N) memory in addition to the factors.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.probing.realised import Factors, split_into_blocks
from pdcd.probing.wanted import WantedMatrix

_IMAGES = 32
"""Rows of the factors that are multiplied by a wanted matrix together."""
EXACT_CELLS = 1024
"""Most cells at which every single pair is evaluated, for the largest deviation."""


class Deviation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The realised matrix compared with the wanted one, relative to the weight 1 of the latter.

    `weight_s` is the best common factor (least squares), in seconds of open mask and lit projector.
    `diagonal_*` are about direct light, point by point; `off_*` about all other paths between cell
    averages: the RMS of all, that of the cell where it is largest, and the largest of any single
    path. The last needs all N^2 pairs, and is left out beyond `EXACT_CELLS`; no path can be further
    off than ``sqrt(N - 1) * off_rms_worst``.
    """

    weight_s: float
    diagonal_max: float
    diagonal_mean: float
    off_rms: float
    off_rms_worst: float
    off_max: float | None = None


def row_weights_s(realised: Factors, wanted: WantedMatrix) -> tuple[Floats, Floats]:
    """Inner products of wanted and realised, and of wanted with itself, row by row, (N,) each.

    The diagonal of the realised matrix is `coaxial`: the weight of direct light.
    """
    cells = wanted.cells
    if wanted.uniform is not None:
        diagonal, off = wanted.uniform
        sums, inside = realised.row_sums_s
        inner = diagonal * realised.coaxial + off * (sums - inside)
        return inner, np.full(cells, diagonal**2 + (cells - 1) * off**2)
    own = wanted.diagonal()
    inner = own * realised.coaxial + _inner(realised.left, realised.right, wanted)
    return inner, own**2 + wanted.squares()


def weight_s(realised: Factors, wanted: WantedMatrix) -> float:
    """Least-squares factor between a realised and a wanted matrix, in seconds.

    Direct light in one photo with indirect light is one entry of a row against N - 1, so that this
    factor follows the indirect light alone. Even codes show indirect light slightly less, or more,
    than p times as long as direct light; with `by_direct` the factor follows direct light instead.

    Windows of parts of cells smear what is finer than a cell: half of the light from a matched cell
    other than the own, and of the edges of stripes, comes from the cells beside it. The
    least-squares factor counts that light as lost, and the photo would be too bright; with
    `by_light` the factor is that of all the light.

    Falls back to the mean open time where the wanted matrix is zero everywhere (one single cell
    has no indirect light).
    """
    if wanted.by_light:
        return _light_weight_s(realised, wanted)
    if wanted.by_direct and wanted.uniform is not None:
        return float(realised.coaxial.mean()) / wanted.uniform[0]
    partner = wanted.matched if wanted.by_direct else None
    if partner is not None:
        return _matched_weight_s(realised, wanted, partner)
    if wanted.by_direct and wanted.light is None:
        return float(realised.coaxial.mean()) / float(wanted.diagonal().mean())
    inner, norm = row_weights_s(realised, wanted)
    total = float(norm.sum())
    return float(inner.sum()) / total if total > 0.0 else float(realised.open_s.mean())


def _light_weight_s(realised: Factors, wanted: WantedMatrix) -> float:
    """Light of all paths except direct light, over the wanted amount, in seconds."""
    kept = realised.total_s - realised.trace_s
    return kept / float(wanted.others(np.ones((1, wanted.cells))).sum())


def _matched_weight_s(realised: Factors, wanted: WantedMatrix, partner: NDArray[np.int64]) -> float:
    """Light that matched cells got, over the wanted amount, in seconds."""
    there = np.flatnonzero(partner >= 0)
    right = realised.right[:, partner[there]]
    got = np.einsum("rn,rn->n", realised.left[:, there], right)
    same = partner[there] == there
    got[same] = realised.coaxial[there[same]]
    return float(got.sum()) / float(wanted.entries(partner).sum())


def measure_deviation(
    realised: Factors,
    wanted: WantedMatrix,
    alive: Callable[[], None] = lambda: None,
    apart: float = 0.0,
) -> Deviation:
    """Compare the two, as exactly as `compute_row_deviations`; `alive` may raise to end the work.

    apart : share of the field in which both panels show different cells
    (`pdcd.probing.borders`). There direct light has the weight of other paths. It is included in
    the mean if all other paths are to have one weight.
    """
    weight = weight_s(realised, wanted)
    scale = weight if weight != 0.0 else 1.0
    mean, variance, diagonal = compute_row_deviations(realised, wanted, scale, alive)
    square = mean**2 + variance
    direct = float(diagonal.mean())
    if apart > 0.0 and wanted.uniform is not None:
        there = float(mean.mean()) + wanted.uniform[1] - wanted.uniform[0]
        direct += apart * (there - direct)
    return Deviation(
        weight_s=weight,
        diagonal_max=float(np.abs(diagonal).max()),
        diagonal_mean=direct,
        off_rms=float(np.sqrt(square.mean())),
        off_rms_worst=float(np.sqrt(square.max())),
        off_max=_largest(realised, wanted, scale) if wanted.cells <= EXACT_CELLS else None,
    )


def compute_row_deviations(
    realised: Factors,
    wanted: WantedMatrix,
    weight: float,
    alive: Callable[[], None] = lambda: None,
) -> tuple[Floats, Floats, Floats]:
    """Realised / weight - wanted, row by row: mean and variance off the diagonal, and the diagonal.

    (N,) float64 each; a scene of one cell has no entries off the diagonal, so 0. `alive` is called
    at every block of cells, and may raise to end the work.

    Parts of the wanted matrix that are products join the factors, so that the rest of a row is
    ``l @ right``. Its variance is ``l @ C @ l`` with the covariance C of `right`, which is never
    negative, less the one entry on the diagonal; other parts add what they share with it.

    Notes
    -----
    Mean squares ``mean^2 + variance`` are exact to ``32 eps a^2`` with ``eps = 2.2e-16`` and ``a =
    sum_r |l_r| rms_r + max |W|``, of the joint factors and the RMS of each row of their right
    sides. For codes lit half of the time, a is about 3.5. So an RMS of 1e-5 or more has at least
    three digits, and codes without any error may show one of 1e-7.
    """
    cells = wanted.cells
    diagonal = realised.coaxial / weight - wanted.diagonal()
    mean, square = np.zeros(cells), np.zeros(cells)
    if cells == 1:
        return mean, square, diagonal
    camera, projector = wanted.products()
    level = np.concatenate([realised.right.mean(axis=1), projector.mean(axis=1)])
    own = np.empty(cells)
    covariance = np.zeros((level.size, level.size))
    for here in split_into_blocks(cells):
        alive()
        right = np.concatenate([realised.right[:, here], projector[:, here]]) - level[:, None]
        covariance += right @ right.T
    for here in split_into_blocks(cells):
        alive()
        left = np.concatenate([realised.left[:, here] / weight, -camera[:, here]])
        right = np.concatenate([realised.right[:, here], projector[:, here]]) - level[:, None]
        mean[here] = level @ left
        own[here] = np.einsum("rn,rn->n", left, right)
        square[here] = np.einsum("rn,rn->n", left, covariance @ left)
    others = cells - 1
    mean -= own / others
    square -= own**2 * (cells / others)
    banded = wanted.banded()
    norm = banded.squares()
    if norm.any():  # not if all that is left of it is on the diagonal
        total = banded.others(np.ones((1, cells)))[0]
        shared = _inner(realised.left, realised.right, banded, level[: -len(projector) or None])
        shared = shared / weight - _inner(camera, projector, banded, projector.mean(axis=1))
        square += norm - total**2 / others - 2.0 * (shared + own / others * total)
        mean -= total / others
    return mean, np.maximum(square / others, 0.0), diagonal


def _inner(
    left: Floats, right: Floats, wanted: WantedMatrix, level: Floats | float = 0.0
) -> Floats:
    """``sum over m != n of (left.T @ (right - level))_nm W_nm``, (N,), for levels (R,)."""
    total = np.zeros(wanted.cells)
    levels = np.broadcast_to(level, len(right))
    for start in range(0, len(right), _IMAGES):
        some = slice(start, start + _IMAGES)
        lit = wanted.others(right[some] - levels[some, None])
        total += np.einsum("rn,rn->n", left[some], lit)
    return total


def _largest(realised: Factors, wanted: WantedMatrix, weight: float) -> float:
    """Largest deviation of any path off the diagonal, from all of them."""
    error = realised.dense() / weight - wanted.dense()
    np.fill_diagonal(error, 0.0)
    return float(np.abs(error).max())
