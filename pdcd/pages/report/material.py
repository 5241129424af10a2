"""What a page is made of, gathered from a decoded run while its pictures are at hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdcd.pages.report.layers import MOST_PICTURES, Layers, Truth, layers, size_of
from pdcd.pages.report.timeline import budget, timeline
from pdcd.pages.report.weights import MOST_WEIGHTS, matrices
from pdcd.pictures.darkroom import Decoded
from pdcd.pictures.decode import TRANSPORT_PICTURE as PICTURE
from pdcd.pictures.truth import Known
from pdcd.runs.record import RunRecord

DEFAULT_S = 0.3
"""A page that costs less of a processor than that is made at the end of every capture."""
FIXED_S, SHOT_S = 0.02, 3e-3
VALUE_S, WEIGHT_S, REFRESH_S = 9e-8, 1e-7, 1e-5
"""Costs by size: of each value of a picture, of each entry of the factors, of each refresh."""


@dataclass(frozen=True)
class Material:
    """The parts of a page that need the photos; all else of it is in the manifest."""

    layers: Layers
    matrices: list[dict[str, Any]]
    shots: list[dict[str, Any]]
    budget: list[dict[str, Any]]
    answer: str
    kind: str
    """How the error of the codes is known (`pdcd.pictures.picture.Kind`)."""
    slice_png: bytes = b""
    """The picture of entries of T, where they were photographed."""


def foreseen_s(record: RunRecord, decoded: Decoded) -> float:
    """Processor time of a page by the size of the run, as measured on a machine of two cores."""
    width, height = size_of(len(decoded.pictures), decoded.view)
    pictures = min(len(decoded.pictures), MOST_PICTURES) + 1
    values = 3 * width * height * pictures
    shots = {**decoded.shots, **decoded.sums}.values()
    entries = sum(s.realised.left.size + s.realised.right.size for s in shots)
    refreshes = sum(shot.refreshes for shot in record.shots)
    quads = 3 * decoded.cells.frame[0] * decoded.cells.frame[1] * pictures
    return (
        FIXED_S
        + SHOT_S * len(record.shots)
        + VALUE_S * (values + 0.3 * quads)
        + WEIGHT_S * min(entries, MOST_WEIGHTS)
        + REFRESH_S * refreshes
    )


def cheap(record: RunRecord, decoded: Decoded) -> bool:
    """Whether a page is made without being asked for."""
    return foreseen_s(record, decoded) < DEFAULT_S


def gathered(folder: Path, record: RunRecord, decoded: Decoded, known: Known | None) -> Material:
    """Everything of a page but the manifest.

    folder : where frames.csv lies. Raises DecodeError for a damaged one.
    """
    truth = None
    if known is not None:
        truth = Truth(*known.binned(decoded.side).on_quads(decoded.cells))
    sliced = decoded.transport
    return Material(
        layers=layers(decoded.pictures, decoded.view, truth, decoded.side),
        matrices=matrices(decoded.recipe, {**decoded.shots, **decoded.sums}, record.normalise),
        shots=timeline(folder, record),
        budget=budget(record, decoded.shots),
        answer=decoded.recipe.answer_name,
        kind=decoded.answer.kind,
        slice_png=b"" if sliced is None else (folder / PICTURE).read_bytes(),
    )
