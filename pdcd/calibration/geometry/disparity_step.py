"""Which projector cell lights each camera cell of an off-axis bench: XOR codes on the scene."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import on_field
from pdcd.calibration.charts import sheet, write
from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.geometry.disparity import Disparities, disparities
from pdcd.calibration.geometry.geometry_step import finer
from pdcd.calibration.geometry.xor import XorCode
from pdcd.calibration.registration.striped import base_px, planes_of
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
        picture=_picture(found),
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


def _picture(found: Disparities) -> NDArray[np.uint8]:
    """Disparities by cell, from far to near; black is unknown."""
    low, high = np.percentile(found.right[found.known], [1.0, 99.0])
    share = (np.nan_to_num(found.right) - low) / max(float(high - low), 1e-9)
    coloured = cv2.applyColorMap(
        (255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8), cv2.COLORMAP_VIRIDIS
    )[..., ::-1]
    coloured = np.where(found.known[..., None], coloured, 0)
    rows, cols = found.known.shape
    scale = max(1, min(860 // cols, 520 // rows))
    whole = np.kron(coloured, np.ones((scale, scale, 1), dtype=np.uint8))
    picture = sheet(40 + cols * scale, 80 + rows * scale)
    picture[60 : 60 + rows * scale, 20 : 20 + cols * scale] = whole
    write(picture, [f"cells to the right: {low:.1f} blue, to {high:.1f} yellow"], (20, 30))
    return picture
