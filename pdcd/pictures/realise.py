"""What the panels did in one shot, by its frame log: its probing matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec

from pdcd.panels.frames import FrameLog, Frames
from pdcd.pictures.weights import RealisedMatrix
from pdcd.probing.realised import Factors, collect_factors, compute_bench_factors, divide_factors
from pdcd.runs.record import RunRecord, ShotRecord

_Alive = Callable[[], None]


def compute_shot_matrix(
    record: RunRecord,
    shot: ShotRecord,
    frames: Frames,
    log: FrameLog,
    alive: _Alive = lambda: None,
) -> RealisedMatrix:
    """The realised probing matrix of a shot of a run, for its darkroom.

    frames, log : as the run's frame table has them. alive : is called now and then, and may raise
    to end the work.
    """
    projector = record.projector
    if record.room is not None:  # it has the light of the projector's black
        projector = msgspec.structs.replace(projector, contrast=None)
    chunks = compute_bench_factors(
        frames,
        log,
        projector,
        record.mask,
        open_ns=shot.open_ns,
        close_ns=shot.close_ns,
        fine=True,
    )
    realised = collect_factors(_watched(chunks, alive))
    if (shot.level or 1.0) != 1.0:
        realised = divide_factors(realised, (shot.level or 1.0))
    return RealisedMatrix(realised, shot.missed if shot.level is None else 0)


def _watched(chunks: Iterator[Factors], alive: _Alive) -> Iterator[Factors]:
    for chunk in chunks:
        alive()
        yield chunk
