"""Which projector cell lights each camera cell of an off-axis bench: XOR codes on the scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdcd.bench.placed import on_field
from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.geometry.disparity import Disparities, disparities
from pdcd.calibration.geometry.geometry_step import finer
from pdcd.calibration.geometry.striped import base_px, planes_of
from pdcd.calibration.geometry.xor import XorCode
from pdcd.calibration.script import Outcome, Script, Session
from pdcd.errors import CalibrationError

KNOWN = 0.5
"""Share of the cells that are matched, at least; the others are dark, in shadow or hidden."""
OFF_ROWS, FAR_OFF_ROWS = 0.5, 2.0
"""Cells by which light leaves its row: rows of cells are no epipolar lines, or not nearly."""


def disparity(session: Session) -> Script:
    """The projector's XOR codes on the scene, 40 photos for 1024 x 768 pixels. What each quad sees
    is averaged over the cells of the configuration, and kept for `--disparities`. Raises
    CalibrationError on a card."""
    if session.subject == "card":
        raise CalibrationError(
            "disparities are of a scene, and not of a card", hint="pdcd calibrate disparity --scene"
        )
    camera, projector = session.found("camera"), session.found("projector")
    size = session.config.projector.size_px
    code = XorCode("projector", size, base_px(1.0 / finer(projector, camera)))
    planes = yield from planes_of(session, code)
    # Of the cells of captures: they divide the field, wherever that lies.
    there = session.on_field.projector
    found = disparities(
        planes.decoded(),
        on_field(camera, there),
        on_field(projector, there),
        session.config.code_grid(),
    )
    return Outcome(
        figures=_figures(found),
        arrays={"disparity.right": found.as_asked()},
        advice=_advice(found),
        picture=lambda figure: _draw(figure, found),
    )


def _figures(found: Disparities) -> tuple[Figure, ...]:
    share, off = float(found.known.mean()), found.off_rows_cells
    low, high = np.percentile(found.right[found.known], [1.0, 99.0]).tolist()
    return (
        Figure(
            "disparity.known", share, 0.0, "", f"at least {KNOWN:g}",
            Verdict.GOOD if share >= KNOWN else Verdict.DOUBTFUL,
        ),
        Figure(
            "disparity.off_rows", off, 0.0, "cells", f"at most {OFF_ROWS:g} cells",
            Verdict.GOOD if off <= OFF_ROWS
            else Verdict.DOUBTFUL if off <= FAR_OFF_ROWS else Verdict.BAD,
        ),
        Figure("disparity.low", low, 0.0, "cells"),
        Figure("disparity.high", high, 0.0, "cells"),
    )  # fmt: skip


def _advice(found: Disparities) -> tuple[str, ...]:
    if found.off_rows_cells <= OFF_ROWS:
        return ()
    return (
        f"light leaves its row by {found.off_rows_cells:.1f} cells: set up camera and projector "
        "side by side, and level, or give a warp in the place of disparities",
    )


def _draw(figure: Any, found: Disparities) -> None:
    """Disparities by cell, from far to near; white is unknown."""
    low, high = np.percentile(found.right[found.known], [1.0, 99.0])
    axes = figure.subplots()
    shown = np.where(found.known, found.right, np.nan)
    figure.colorbar(axes.imshow(shown, vmin=low, vmax=high, interpolation="nearest"))
    axes.set_title("cells to the right", fontsize=10)
