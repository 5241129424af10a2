"""A run's pictures, made again from its RAW files with options other than the run's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.api.progress import EventListener, watch_decoding
from pdcd.capture.worker.answers import compute_rms_sigma
from pdcd.errors import RequestError
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import convert_record_errors
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.picture import PictureWithErrors
from pdcd.runs.record import RunRecord
from pdcd.verdict.error_budget import ErrorRow, make_error_budget
from pdcd.words import NormaliseName


@dataclass(frozen=True, eq=False)
class DecodingResult:
    """The result of decoding a run again.

    image, sigma : (rows, cols, C) float64; C is 3, or 1 for a camera without colours
        As in the run: means over the cells, scene units.
    sigma_kind : "measured", "sensor" or "whole" (`pdcd.api.run.Run.sigma_kind`).
    rms_sigma : RMS sigma over RMS image, on the camera's quads; infinite where that is not known.
    pictures : by name, each with `.image` and `.sigma`, (h, w, C), a pixel for each of the camera's
        quads, and the two parts of sigma, `.sensor` and `.code`.
    """

    image: NDArray[np.float64]
    sigma: NDArray[np.float64]
    sigma_kind: str
    rms_sigma: float
    pictures: Mapping[str, PictureWithErrors]


def decode_again(
    folder: Path,
    record: RunRecord,
    *,
    smooth: bool | None,
    normalise: NormaliseName | None,
    parts: int | None,
    on_event: EventListener | None,
) -> DecodingResult:
    """Make the pictures of a run again; nothing is written. None keeps the run's own option.

    Raises RequestError for a number of parts that the run does not have, and DecodeError.
    """
    watch = watch_decoding(on_event)
    if not isinstance(parts, int | None) or isinstance(parts, bool):
        raise RequestError(f"parts: {parts!r} is no number of parts", hint="give 1, 2, 3 ...")
    with convert_record_errors(folder):
        record = msgspec.structs.replace(
            record,
            smooth=record.smooth if smooth is None else smooth,
            normalise=normalise or record.normalise,
        )
        darkroom = Darkroom(folder, record)
        if parts is not None:
            darkroom = Darkroom(folder, _first(darkroom, parts))
        return _told(darkroom.decoded(watch))


def compute_error_budget(
    folder: Path, record: RunRecord, on_event: EventListener | None
) -> tuple[ErrorRow, ...]:
    """The sources of the error of a run's answer (`Run.error_budget`). Raises DecodeError."""
    with convert_record_errors(folder):
        darkroom = Darkroom(folder, record)
        decoded = darkroom.decoded(watch_decoding(on_event))
        return make_error_budget(darkroom.record, decoded)


def _told(decoded: DecodedRun) -> DecodingResult:
    means = decoded.cell_means
    return DecodingResult(
        image=np.asarray(means.image, dtype=np.float64),
        sigma=np.asarray(means.sigma, dtype=np.float64),
        sigma_kind=means.kind,
        rms_sigma=compute_rms_sigma(decoded.answer),
        pictures=decoded.pictures,
    )


def _first(darkroom: Darkroom, parts: int) -> RunRecord:
    """The record with the shots of the first parts only. Raises RequestError."""
    record = darkroom.record
    part_of = {shot.name: shot.part for shot in darkroom.recipe.shots}
    there = {part_of[shot.name] for shot in record.shots} - {0}
    if not 1 <= parts <= len(there):
        raise RequestError(
            f"the run has {len(there) or 'no'} parts, not {parts}",
            hint="capture with parts=4 or more to look at fewer of them",
        )
    kept = {0, *sorted(there)[:parts]}
    shots = tuple(shot for shot in record.shots if part_of[shot.name] in kept)
    return msgspec.structs.replace(record, shots=shots)
