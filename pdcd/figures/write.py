"""From the photos of one figure to its files, and to what the page says of it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.figures.figure import Drawn, Figure, Mode, Number, Photo, Row, Take
from pdcd.figures.picture import drawn as drawn_row
from pdcd.figures.plot import plotted
from pdcd.figures.store import Captured, Made, Shown, ShownRow, Stated, Store
from pdcd.files.images import png_of


def write_figure(
    store: Store,
    figure: Figure,
    mode: Mode,
    takes: Mapping[str, Take],
    photos: Mapping[str, Photo],
    *,
    plots: bool,
) -> Made:
    """Draw a figure, write its pictures, and note it as made. Raises PdcdError."""
    shown = figure.drawn(mode, photos)
    made = Made(
        number=figure.number,
        fingerprint=store.fingerprint(figure),
        mode=mode.name,
        title=figure.title,
        see=figure.see,
        paper=figure.paper,
        unlike=figure.unlike,
        rows=tuple(_row(store, figure.number, k, row) for k, row in enumerate(shown.rows)),
        plots=tuple(_plots(store, figure.number, shown)) if plots else (),
        numbers=tuple(stated(number) for number in shown.numbers),
        captures=tuple(captured(name, takes[name], photos[name]) for name in takes),
        seconds=sum(float(photo.summary.get("wall_s") or 0.0) for photo in photos.values()),
    )
    store.put(made)
    return made


def stated(number: Number) -> Stated:
    """A number as the page has it; what is no number is said to be none."""
    value = number.value if math.isfinite(number.value) else None
    bounds = number.least, number.most
    return Stated(number.what, value, *bounds, number.paper, number.percent, number.held)


def captured(name: str, take: Take, photo: Photo) -> Captured:
    """A capture in figures."""
    summary = photo.summary
    error = photo.error if photo.transport is None else _of_entries(photo)
    error = error if error is not None and math.isfinite(error) else None
    held = take.bound is None or (error is not None and error <= take.bound)
    return Captured(
        name=name,
        said=take.said,
        goal=take.goal,
        scene=take.scene,
        codes=_whole(summary.get("codes")) if summary.get("family") != "none" else None,
        family=summary.get("family"),
        exposures=_whole(summary.get("shots")),
        exposure_s=summary.get("exposure_s"),
        error=error,
        bound=take.bound,
        held=held,
    )


def _of_entries(photo: Photo) -> float | None:
    """RMS error of photographed entries of T over the RMS of the true ones, where known."""
    if photo.transport is None or photo.transport_truth is None:
        return None
    known = np.isfinite(photo.transport)
    off = np.sum((photo.transport - photo.transport_truth) ** 2, where=known)
    return float(np.sqrt(off / np.sum(photo.transport_truth**2, where=known)))


def _whole(value: Any) -> int | None:
    return int(value) if isinstance(value, int | float) else None


def _row(store: Store, number: str, k: int, row: Row) -> ShownRow:
    pictures = []
    for index, (panel, pixels) in enumerate(zip(row.panels, drawn_row(row), strict=True)):
        words = re.sub(r"[^a-z0-9]+", "-", panel.caption.lower()).strip("-")[:40]
        file = f"fig-{number}-{k + 1}{chr(ord('a') + index)}-{words}.png"
        store.write(file, png_of(pixels))
        pictures.append(Shown(file, panel.caption))
    return ShownRow(row.title, tuple(pictures), row.small)


def _plots(store: Store, number: str, shown: Drawn) -> list[Shown]:
    found = []
    for plot in shown.plots:
        file = f"fig-{number}-{plot.name}.png"
        store.write(file, plotted(plot))
        found.append(Shown(file, plot.caption, plot.wide))
    return found
