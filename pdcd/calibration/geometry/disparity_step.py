"""Which projector cell lights each camera cell of an off-axis bench: XOR codes on the scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdcd.bench.placed import map_to_field
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.geometry.disparity import Disparities, measure_disparities
from pdcd.calibration.geometry.geometry_step import compute_pixel_ratio
from pdcd.calibration.geometry.striped import base_px, photograph_xor_code
from pdcd.calibration.geometry.xor import XorCode
from pdcd.calibration.preview import label_plot
from pdcd.calibration.script import CalibrationSession, StepOutcome, StepScript
from pdcd.errors import CalibrationError

_KNOWN = 0.5
"""Share of the cells that are matched, at least; the others are dark, in shadow or hidden."""
_OFF_ROWS, _FAR_OFF_ROWS = 0.5, 2.0
"""Cells by which light leaves its row, from which rows of cells are not quite epipolar lines, or
far from it."""


def calibrate_disparity(session: CalibrationSession) -> StepScript:
    """The projector's XOR codes on the scene, 40 photos for 1024 x 768 pixels. What each quad sees
    is averaged over the cells of the configuration, and kept for `--disparities`. Raises
    CalibrationError on a card."""
    if session.subject == "card":
        raise CalibrationError(
            "disparities are measured on a scene, not on a card",
            hint="pdcd calibrate disparity --scene",
        )
    camera, projector = session.found("camera"), session.found("projector")
    size = session.config.projector.size_px
    code = XorCode("projector", size, base_px(1.0 / compute_pixel_ratio(projector, camera)))
    planes = yield from photograph_xor_code(session, code)
    # Relative to the cells of captures: they divide the field, wherever that lies.
    there = session.on_field.projector
    found = measure_disparities(
        planes.decoded(),
        map_to_field(camera, there),
        map_to_field(projector, there),
        session.config.code_grid(),
    )
    return StepOutcome(
        figures=_figures(found),
        arrays={"disparity.right": found.as_asked()},
        advice=_advice(found),
        picture=lambda figure: _draw(figure, found),
    )


def _figures(found: Disparities) -> tuple[MeasuredFigure, ...]:
    share, off = float(found.known.mean()), found.off_rows_cells
    low, high = np.percentile(found.right[found.known], [1.0, 99.0]).tolist()
    return (
        MeasuredFigure(
            "disparity.known", share, 0.0, "", f"at least {_KNOWN:g}",
            Verdict.GOOD if share >= _KNOWN else Verdict.DOUBTFUL,
        ),
        MeasuredFigure(
            "disparity.off_rows", off, 0.0, "cells", f"at most {_OFF_ROWS:g} cells",
            Verdict.GOOD if off <= _OFF_ROWS
            else Verdict.DOUBTFUL if off <= _FAR_OFF_ROWS else Verdict.BAD,
        ),
        MeasuredFigure("disparity.low", low, 0.0, "cells"),
        MeasuredFigure("disparity.high", high, 0.0, "cells"),
    )  # fmt: skip


def _advice(found: Disparities) -> tuple[str, ...]:
    if found.off_rows_cells <= _OFF_ROWS:
        return ()
    return (
        f"light leaves its row by {found.off_rows_cells:.1f} cells: set up camera and projector "
        "side by side, and level, or give a warp in place of disparities",
    )


def _draw(figure: Any, found: Disparities) -> None:
    """Disparities by cell, from far to near; white is unknown."""
    low, high = np.percentile(found.right[found.known], [1.0, 99.0])
    axes = figure.subplots()
    shown = np.where(found.known, found.right, np.nan)
    drawn = axes.imshow(shown, vmin=low, vmax=high, interpolation="nearest")
    figure.colorbar(drawn, label="cells to the right")
    label_plot(axes, "Disparity, far to near (blank: not known)", "cells", "cells")
    axes.grid(visible=False)
