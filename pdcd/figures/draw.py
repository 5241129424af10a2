"""From linear light and lines to PNG files: one scale of brightness a row, one style of plots.

matplotlib is an extra, and is only loaded when a plot is drawn.
"""

from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bytes
from pdcd.errors import ConfigError
from pdcd.extras import suggest_install
from pdcd.figures.figure import FigurePanel, FigurePlot, PanelRow
from pdcd.pictures.written.looks import LEVEL, LEVEL_PERCENT
from pdcd.pictures.written.picture_files import draw_caption
from pdcd.pictures.written.previews import encode_gamma

_LEAST_PX = 480
"""Least width of a picture; a narrower one is enlarged, so that its strip can be read."""
_LARGER = 1.5
"""Factor on the letters of strips, as up to four pictures stand in a row."""
SHOWN = (0.0, 0.25, 1.0)
"""Values on the scale of greys, linear."""
_RIM = 0.008
"""Share of the width that is cut off at each side, where quads see the field only in part."""
UNKNOWN = 60
"""Grey of places that no quad of the camera shows."""
_DPI, _SIZE_IN = 110, (5.6, 3.8)
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#555555", "#56b4e9")
"""Colours of the lines of a plot, by Okabe and Ito: distinct without telling red from green."""
MARKERS = "osD^vPX"
"""Shapes of their points, in the same order."""


def draw_row(row: PanelRow) -> list[Bytes]:
    """All panels of a row, drawn with their strips, (H, W, 3) uint8 each."""
    usual = white_of(row.panels[0].image) or 1.0
    return [_drawn(panel, panel.white or usual) for panel in row.panels]


def white_of(image: NDArray[Any]) -> float:
    """Scene units that are shown as white, so that the brightest hundredth of a picture reaches
    `LEVEL` or more; 0 for a picture without light."""
    known = image[np.isfinite(image)]
    return float(np.percentile(np.abs(known), LEVEL_PERCENT)) / LEVEL if known.size else 0.0


def _drawn(panel: FigurePanel, white: float) -> Bytes:
    if panel.kind == "grey":
        pixels = _coloured(np.asarray(panel.image, np.uint8))
        factor = max(-(-_LEAST_PX // pixels.shape[1]), 1)  # whole, so that all squares are alike
        return _with_strip(pixels.repeat(factor, axis=0).repeat(factor, axis=1), panel.caption, ())
    rim = max(round(_RIM * panel.image.shape[1]), 1)
    image = _coloured(np.asarray(panel.image, np.float32)[rim:-rim, rim:-rim])
    linear = np.nan_to_num(image) / np.float32(white)
    if panel.signed:
        # 0 as middle grey: linear about it, for a gamma would bend both signs unlike.
        pixels = np.rint(255.0 * np.clip(0.5 + 0.5 * linear, 0.0, 1.0)).astype(np.uint8)
        marks = tuple((round(255 * (0.5 + 0.5 * g)), f"{g * white:.2g}") for g in (-1.0, 0.0, 1.0))
    else:
        pixels = encode_gamma(linear)
        marks = tuple((int(encode_gamma(np.float32(g))), f"{g * white:.2g}") for g in SHOWN)
    pixels[~np.isfinite(image).all(axis=-1)] = UNKNOWN
    height, width = pixels.shape[:2]
    if width < _LEAST_PX:
        size_px = _LEAST_PX, round(height * _LEAST_PX / width)
        pixels = np.asarray(cv2.resize(pixels, size_px, interpolation=cv2.INTER_CUBIC), np.uint8)
    return _with_strip(pixels, panel.caption, marks)


def _coloured(image: NDArray[Any]) -> NDArray[Any]:
    image = image if image.ndim == 3 else image[..., None]
    return image if image.shape[2] == 3 else np.repeat(image, 3, axis=2)


def _with_strip(pixels: Bytes, caption: str, marks: tuple[tuple[int, str], ...]) -> Bytes:
    plain = caption.encode("ascii", "replace").decode()
    notes = ["scene units"] if marks else [""]
    return np.concatenate([pixels, draw_caption(pixels.shape[1], plain, notes, marks, _LARGER)])


def check_plots() -> None:
    """Raise ConfigError, which says what to install, if no plot can be drawn."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as err:
        raise ConfigError(
            "plots need matplotlib",
            hint=f"{suggest_install('matplotlib')}, or leave plots out: --no-plots",
        ) from err


def draw_plot(plot: FigurePlot) -> bytes:
    """A plot as the bytes of a PNG file. Raises ConfigError without matplotlib."""
    check_plots()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_IN, layout="constrained")
    FigureCanvasAgg(figure)
    _fill(figure.add_subplot(), plot)
    file = io.BytesIO()
    figure.savefig(file, dpi=_DPI, format="png", metadata={"Software": None})
    return file.getvalue()


def _fill(axes: Any, plot: FigurePlot) -> None:
    """Draw a plot on axes of matplotlib, with small labels."""
    axes.grid(alpha=0.3)
    axes.tick_params(labelsize=10)
    for line in plot.lines:
        at, style = line.colour, line.style
        colour = at if isinstance(at, str) else PALETTE[at % len(PALETTE)]
        if not isinstance(at, str):
            style = style.replace("o", MARKERS[at % len(MARKERS)])
        axes.plot(line.x, line.y, style, color=colour, label=line.label or None, lw=1.4, ms=5)
    for place, words in plot.marks:
        axes.axvline(place, color="grey", lw=0.8)
        axes.annotate(words, (place, 0.98), xycoords=("data", "axes fraction"), fontsize=9,
                      rotation=90, ha="right", va="top", color="grey")  # fmt: skip
    if plot.level is not None:
        axes.axhline(plot.level, color="black", lw=0.6)
    if plot.band is not None:
        axes.axvspan(*plot.band, color="0.9")
    for set_scale, scale in zip((axes.set_xscale, axes.set_yscale), plot.scales, strict=True):
        set_scale(scale, **({"linthresh": 1e-3} if scale == "symlog" else {}))
    axes.set_xlim(left=plot.x_from)
    axes.set_ylim(*plot.y_range)
    axes.set_title(plot.title, fontsize=12)
    axes.set_xlabel(plot.x, fontsize=11)
    axes.set_ylabel(plot.y, fontsize=11)
    if any(line.label for line in plot.lines):
        axes.legend(fontsize=10)
