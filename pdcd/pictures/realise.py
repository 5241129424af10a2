"""What the panels did in one shot, from its frame log: its probing matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
import numpy as np

from pdcd.arrays import Floats
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
    to end the work. crossed : whether `RealisedMatrix.crossed` is wanted, too.
    """
    projector = record.projector
    if record.room is not None:  # it has the light of the projector's black
        projector = msgspec.structs.replace(projector, contrast=None)

    def realise(late_s: float = 0.0, *, fine: bool = False) -> Factors:
        mask = msgspec.structs.replace(record.mask, skew_s=record.mask.skew_s + late_s)
        chunks = compute_bench_factors(
            frames,
            log,
            projector,
            mask,
            open_ns=shot.open_ns,
            close_ns=shot.close_ns,
            fine=fine,
        )
        return collect_factors(_watched(chunks, alive))

    realised = realise(fine=True)
    found = None
    if crossed and len(frames.primal_patterns) > 1:
        row_s = 1e-9 * float(np.median(np.diff(log.primal_ns)))
        sides = [_find_crossed(realise, sign * row_s, realised) for sign in (1.0, -1.0)]
        found = sides[0], sides[1]
    if (shot.level or 1.0) != 1.0:
        realised = divide_factors(realised, (shot.level or 1.0))
    return RealisedMatrix(realised, shot.missed if shot.level is None else 0, found)


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


def _watched(chunks: Iterator[Factors], alive: _Alive) -> Iterator[Factors]:
    for chunk in chunks:
        alive()
        yield chunk
