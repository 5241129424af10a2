"""What one figure is: the captures that it takes, and the pictures, plots and numbers of them.

A file `pdcd/figures/figNN.py` holds one `FIGURE`. It says in plain values what is to be captured
(`takes`), and makes of the photos what is to be seen (`drawn`). It touches no bench, no disk and no
clock: captures are taken by `pdcd.figures.photo`, pictures written by `pdcd.figures.picture`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pdcd.words import GoalName

Image = NDArray[np.floating]
Grid = tuple[int, int]

PRINTED = 4
"""Codes that the paper counts for each independent one: its four sub-shifts."""


@dataclass(frozen=True)
class Mode:
    """How finely figures are taken.

    grid : rows and columns of cells; the paper's codes have 48 x 64.
    quads : (width, height) of the camera's frame in Bayer quads.
    width_px : width of the pictures of the field.
    quick : whether figures may leave out what only a long run can show.
    thrift, least_codes : captures get that many times fewer codes than they ask for, but at least
        so many.
    """

    name: str
    grid: Grid
    quads: tuple[int, int]
    width_px: int
    quick: bool
    thrift: int = 1
    least_codes: int = 32

    def bound(self, quick: float, full: float) -> float:
        """A bound that is another on the full page: its cells are finer, its quads noisier."""
        return quick if self.quick else full

    def codes(self, asked: int) -> int:
        """Independent codes of a capture that asks for so many."""
        return min(asked, max(asked // self.thrift, self.least_codes))


QUICK = Mode("quick", (30, 40), (336, 224), 320, True, thrift=4)
FULL = Mode("full", (48, 64), (2145, 1428), 1280, False)
"""The frame of the paper's camera, an EOS 450D."""
TINY = Mode("tiny", (12, 16), (120, 80), 100, True, thrift=4, least_codes=16)
"""For tests, which look at numbers alone."""


@dataclass(frozen=True)
class Take:
    """One capture: what stands before the bench, and what is asked, in the words of a request.

    scene, options : `[scene] kind` and `[scene.options]` of the configuration.
    asked : fields of `CaptureRequest` beside `goal`; arrays as numpy arrays.
    off_axis : whether the camera stands off the projector's axis.
    perfect : panels that are aligned, quick and dark; the sensor is as noisy as ever.
    f_number : of the lens; None: by test exposures, so that nothing saturates.
    all_codes : as many codes as asked for in every mode, where their number is the matter.
    bound : most RMS error that the answer may have against the known truth, as a share of its RMS;
        None where the truth of an answer is not known, or is no matter of the figure.
    grid : rows and columns of cells, where they are not the mode's.
    said : a few words for the table of captures: "the paper's codes".
    """

    scene: str
    goal: GoalName
    asked: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    off_axis: bool = False
    perfect: bool = False
    f_number: float | None = None
    all_codes: bool = False
    bound: float | None = None
    grid: Grid | None = None
    said: str = ""

    @property
    def stands(self) -> str:
        """What of it makes the bench: captures of which this is equal can share one."""
        bench = self.off_axis, self.perfect, self.f_number, self.grid
        return repr((self.scene, sorted(self.options.items()), bench))


@dataclass(frozen=True, eq=False)
class Photo:
    """What a capture gave, on a raster of the field: upright, as the projector sees the scene.

    pictures : by the names that the run has (`white`, `direct`, the goal ...), answer first; each
        (H, W, 3) float32, linear, scene units; NaN where nothing is known.
    truths : the same pictures as the scene really is, seen through the same optics.
    errors : RMS error of each picture against its truth, over the RMS of the truth, taken over the
        camera's own quads and not over the raster, but for a narrow border of the field.
    transport, transport_truth : (C, J, 3) entries of T of the goal "transport", else None.
    summary : of the run, as `pdcd capture --json` tells it.
    grid : rows and columns of cells.
    """

    pictures: Mapping[str, Image]
    truths: Mapping[str, Image]
    errors: Mapping[str, float]
    transport: Image | None
    transport_truth: Image | None
    summary: Mapping[str, Any]
    grid: Grid

    @property
    def answer(self) -> str:
        """Name of the picture that was asked for."""
        return next(iter(self.pictures))

    @property
    def image(self) -> Image:
        """The picture that was asked for, (H, W, 3)."""
        return self.pictures[self.answer]

    @property
    def truth(self) -> Image:
        """What it is in truth, (H, W, 3)."""
        return self.truths[self.answer]

    @property
    def error(self) -> float:
        """RMS error of the answer over the RMS of its truth."""
        return self.errors[self.answer]


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture of a figure.

    image : (H, W, 3) or (H, W); linear light in scene units, or with `kind` "grey" the pixels
        themselves, uint8, drawn by the figure.
    caption : below it, a few words.
    white : scene units that are shown as white; None: as the other panels of the row, by the
        brightest hundredth of the row's first panel.
    signed : 0 is shown as middle grey, as a difference has both signs.
    """

    image: NDArray[Any]
    caption: str
    white: float | None = None
    signed: bool = False
    kind: Literal["light", "grey"] = "light"


@dataclass(frozen=True)
class Row:
    """Panels side by side, under one scale of brightness. title : above them; may be empty. small :
    many rows are shown on little room."""

    panels: tuple[Panel, ...]
    title: str = ""
    small: bool = False


@dataclass(frozen=True)
class Plot:
    """One plot. draw : gets the axes of matplotlib (`pdcd.figures.plot` has the style), and labels
    both with their units. caption : below it."""

    name: str
    draw: Callable[[Any], None]
    caption: str
    wide: bool = False


@dataclass(frozen=True)
class Number:
    """One figure with the bounds that were stated before it was measured.

    what : in words, with the unit. least, most : bounds, both included; None is no bound. paper :
    what the paper prints, as printed, where it prints one. percent : shown as a percentage.
    """

    what: str
    value: float
    least: float | None = None
    most: float | None = None
    paper: str = ""
    percent: bool = False

    @property
    def held(self) -> bool:
        """Whether it lies within its bounds; what is no number does not."""
        low = self.least is None or self.value >= self.least
        return (
            bool(np.isfinite(self.value)) and low and (self.most is None or self.value <= self.most)
        )


@dataclass(frozen=True)
class Drawn:
    """What a figure shows. The table of its captures, with their errors and bounds, is added."""

    rows: tuple[Row, ...] = ()
    plots: tuple[Plot, ...] = ()
    numbers: tuple[Number, ...] = ()


@dataclass(frozen=True)
class Figure:
    """One figure of the paper.

    number : as it is asked for: "1", "table-1", "appendix".
    see : one sentence on what to see. paper : what the paper took, with its codes and exposure.
    unlike : what is still unlike the paper's own; empty where nothing is.
    takes : mode -> captures by name. drawn : mode and photos by the same names -> what is shown.
    """

    number: str
    title: str
    see: str
    paper: str
    unlike: str
    takes: Callable[[Mode], Mapping[str, Take]]
    drawn: Callable[[Mode, Mapping[str, Photo]], Drawn]


def codes_printed(count: int) -> int:
    """Independent codes of so many as the paper counts them. Every figure asks by that."""
    return max(count // PRINTED, 1)


LIKE_THE_PAPER: Mapping[str, Any] = {"window": "quarter", "guards": "full", "black_level": "mask"}
"""Panels driven as in the paper: quarter windows, three refreshes a code, and a second photo with a
black mask for what leaks through it. 512 printed codes then take 25.6 s a photo."""
PAPERS_CODES: Mapping[str, Any] = {
    **LIKE_THE_PAPER,
    "family": "bernoulli",
    "smooth": False,
    "normalise": "scalar",
    "pilot": 0,
    "parts": 1,
}
"""Coins, and one number to divide a photo by."""
OUR_CODES: Mapping[str, Any] = {**LIKE_THE_PAPER, "pilot": 0, "parts": 1}
"""The same light, time and number of codes, by the codes and the decoding that are default here."""
