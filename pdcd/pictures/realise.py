"""What the panels did in one shot, from its frame log: its probing matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.tables import PanelConfig
from pdcd.panels.frames import FrameLog, Frames
from pdcd.pictures.weights import RealisedMatrix
from pdcd.probing.realised import Factors, collect_factors, compute_bench_factors, divide_factors
from pdcd.runs.record import RunRecord, ShotRecord

_Alive = Callable[[], None]


_LATE_ROWS = (0.5, 1.5, 2.5)
"""Rows of a programme by which the mask is assumed late or early: guards absorb the first ones."""
_CROSSED = 1e-3
"""Light through own cells, over the time of an open mask, from which codes count as meeting."""


def compute_shot_matrix(
    record: RunRecord,
    shot: ShotRecord,
    frames: Frames,
    log: FrameLog,
    alive: _Alive = lambda: None,
    *,
    crossed: bool = False,
) -> RealisedMatrix:
    """The realised probing matrix of a shot of a run, for its darkroom.

    frames, log : as the run's frame table has them. alive : is called now and then, and may raise
    to end the work. crossed : whether `RealisedMatrix.crossed` and `slow` are wanted, too.
    """
    projector, level = record.projector, shot.level or 1.0
    if record.room is not None:  # it has the light of the projector's black
        projector = msgspec.structs.replace(projector, contrast=None)

    def realise(mask: PanelConfig, projector: PanelConfig, *, fine: bool = False) -> Factors:
        chunks = compute_bench_factors(
            frames,
            log,
            projector,
            mask,
            open_ns=shot.open_ns,
            close_ns=shot.close_ns,
            fine=fine,
        )
        factors = collect_factors(_watched(chunks, alive))
        return factors if level == 1.0 else divide_factors(factors, level)

    realised = realise(record.mask, projector, fine=True)
    found = slow = None
    if crossed and len(frames.primal_patterns) > 1:

        def realise_late(late_s: float) -> Factors:
            mask = record.mask
            return realise(msgspec.structs.replace(mask, skew_s=mask.skew_s + late_s), projector)

        row_s = 1e-9 * float(np.median(np.diff(log.primal_ns)))
        sides = [_find_crossed(realise_late, sign * row_s, realised) for sign in (1.0, -1.0)]
        found = sides[0], sides[1]
        slow = _find_slow(realise, record.mask, projector, realised)
    missed = shot.missed if shot.level is None else 0
    return RealisedMatrix(realised, missed, found, slow)


def _find_crossed(
    realise: Callable[[float], Factors], row_s: float, as_believed: Factors
) -> Floats:
    """One side of `RealisedMatrix.crossed`: at the least lateness at which codes meet others."""
    more = np.zeros(as_believed.coaxial.shape)
    for rows in _LATE_ROWS:
        more = realise(rows * row_s).coaxial - as_believed.coaxial
        if float(more.mean()) > _CROSSED * float(as_believed.open_s.mean()):
            break
    return np.asarray(more)


def _find_slow(
    realise: Callable[[PanelConfig, PanelConfig], Factors],
    mask: PanelConfig,
    projector: PanelConfig,
    as_believed: Factors,
) -> Floats:
    """`RealisedMatrix.slow`: light through own cells if panels had perfect blacks and places."""
    replace = msgspec.structs.replace
    exact_mask = replace(mask, contrast=None, offset_px=(0.0, 0.0), blur_px=0.0)
    exact_projector = replace(projector, contrast=None)
    alike = (exact_mask, exact_projector) == (mask, projector)
    found = as_believed if alike else realise(exact_mask, exact_projector)
    return found.coaxial


def _watched(chunks: Iterator[Factors], alive: _Alive) -> Iterator[Factors]:
    for chunk in chunks:
        alive()
        yield chunk
