"""The parts of a page, gathered from a decoded run while its pictures are in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdcd.files.reading import MAX_PICTURE_BYTES, read_file, refuse_unsound
from pdcd.pages.report.layers import (
    MOST_PICTURES,
    AnswerTruth,
    Layers,
    choose_layer_size,
    pack_layers,
)
from pdcd.pages.report.timeline import make_light_budget, make_timeline
from pdcd.pages.report.weights import MOST_WEIGHTS, pack_matrices
from pdcd.pictures.decode import TRANSPORT_PICTURE as PICTURE
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.truth import KnownAnswer
from pdcd.probing.deviation import Deviation
from pdcd.runs.record import RunRecord
from pdcd.verdict.error_budget import ErrorRow, make_error_budget

DEFAULT_S = 0.3
"""A page that takes less processor time than this is made at the end of every capture."""
_FIXED_S, _SHOT_S = 0.02, 3e-3
_VALUE_S, _WEIGHT_S, _REFRESH_S = 9e-8, 1e-7, 1e-5
"""Seconds for each value of a picture, for each entry of the factors, and for each refresh."""


@dataclass(frozen=True)
class Material:
    """The parts of a page that need the photos; everything else on it is in the manifest."""

    layers: Layers
    matrices: list[dict[str, Any]]
    shots: list[dict[str, Any]]
    budget: list[dict[str, Any]]
    answer: str
    kind: str
    """How the error of the codes is known (`pdcd.pictures.picture._Kind`)."""
    errors: tuple[ErrorRow, ...] = ()
    """The error budget of the answer."""
    slice_png: bytes = b""
    """The picture of entries of T, where they were photographed."""


def foreseen_page_s(record: RunRecord, decoded: DecodedRun) -> float:
    """Estimated processor time of a page, from the run's size; measured on a two-core machine."""
    width, height = choose_layer_size(len(decoded.pictures), decoded.view)
    pictures = min(len(decoded.pictures), MOST_PICTURES) + 1
    colours = len(record.responsivity_e)
    values = colours * width * height * pictures
    shots = {**decoded.shots, **decoded.sums}.values()
    entries = sum(s.realised.left.size + s.realised.right.size for s in shots)
    refreshes = sum(shot.refreshes for shot in record.shots)
    quads = colours * decoded.cells.frame[0] * decoded.cells.frame[1] * pictures
    return (
        _FIXED_S
        + _SHOT_S * len(record.shots)
        + _VALUE_S * (values + 0.3 * quads)
        + _WEIGHT_S * min(entries, MOST_WEIGHTS)
        + _REFRESH_S * refreshes
    )


def is_cheap(record: RunRecord, decoded: DecodedRun) -> bool:
    """Whether a page is made without being asked for."""
    return foreseen_page_s(record, decoded) < DEFAULT_S


def gather_material(
    folder: Path,
    record: RunRecord,
    decoded: DecodedRun,
    known: KnownAnswer | None,
    deviations: Mapping[str, Deviation] | None = None,
) -> Material:
    """Everything of a page but the manifest.

    folder : the folder of frames.csv. deviations : as for `make_error_budget`. Raises DecodeError
    if frames.csv is damaged.
    """
    truth = None
    if known is not None:
        truth = AnswerTruth(*known.binned(decoded.side).on_quads(decoded.cells))
    return Material(
        layers=pack_layers(decoded.pictures, decoded.view, truth, decoded.side),
        matrices=pack_matrices(decoded.recipe, {**decoded.shots, **decoded.sums}, record.normalise),
        shots=make_timeline(folder, record),
        budget=make_light_budget(record, decoded.shots),
        errors=make_error_budget(record, decoded, deviations),
        answer=decoded.recipe.answer_name,
        kind=decoded.answer.kind,
        slice_png=b"" if decoded.transport is None else _read_picture(folder / PICTURE),
    )


def _read_picture(path: Path) -> bytes:
    with refuse_unsound(path):
        return read_file(path, MAX_PICTURE_BYTES)
