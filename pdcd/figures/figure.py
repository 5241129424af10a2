"""Defines a figure: the captures that it takes, and the pictures, plots and numbers made of them.

A file `pdcd/figures/figNN.py` holds one `FIGURE`. Its `takes` says in plain values what to capture,
and its `shown` yields what to show of the photos: rows of pictures, plots, numbers with their
bounds. A figure uses no bench, no disk and no clock: `pdcd.figures.photo` takes the captures, and
`pdcd.figures.draw` draws pictures and plots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.sensor.profile import load_profile
from pdcd.words import GoalName

Image = NDArray[np.floating]
GridShape = tuple[int, int]

PRINTED = 4
"""Codes that the paper counts for each independent one: its four sub-shifts."""


PAPER_PROFILE = "450d"
"""Sensor of the paper's camera, an EOS 450D."""


@dataclass(frozen=True)
class FigureMode:
    """How finely figures are taken.

    grid : rows and columns of cells; the paper's codes have 48 x 64.
    quads : (width, height) of the camera's frame in Bayer quads.
    width_px : width of the pictures of the field.
    quick : whether figures may leave out what only a long run can show.
    thrift, least_codes : captures get fewer codes than they ask for, by the factor `thrift`, but at
        least `least_codes`.
    profile : sensor profile of the camera; without colours, a pixel takes the place of a quad.
    """

    name: str
    grid: GridShape
    quads: tuple[int, int]
    width_px: int
    quick: bool
    thrift: int = 1
    least_codes: int = 32
    profile: str = PAPER_PROFILE

    @property
    def samples(self) -> tuple[int, int]:
        """(width, height) of the camera's frame in samples."""
        side = 2 if load_profile(self.profile).colours == 3 else 1
        return side * self.quads[0], side * self.quads[1]

    def bound(self, quick: float, full: float) -> float:
        """A bound that differs on the full page, where cells are finer and quads noisier."""
        return quick if self.quick else full

    def codes(self, asked: int) -> int:
        """Independent codes of a capture that asks for `asked` codes."""
        return min(asked, max(asked // self.thrift, self.least_codes))


QUICK_MODE = FigureMode("quick", (30, 40), (336, 224), 320, True, thrift=4)
FULL_MODE = FigureMode("full", (48, 64), (2145, 1428), 1280, False)
"""The frame of the paper's camera."""


@dataclass(frozen=True)
class FigureTake:
    """One capture: the scene in front of the bench, and what is requested.

    scene, options : `[scene] kind` and `[scene.options]` of the configuration.
    asked : fields of `CaptureRequest` besides `goal`; arrays as numpy arrays.
    off_axis : whether the camera stands off the projector's axis.
    perfect : panels that are aligned, quick and dark; the sensor is as noisy as ever.
    f_number : of the lens in front of the paper's sensor; for another sensor it is converted to
        fill that one as much. None: by test exposures, so that nothing saturates.
    all_codes : take as many codes as asked for in every mode, as their number matters here.
    bound : largest RMS error that the answer may have against the known truth, as a share of its
        RMS; None if the truth is not known, or does not matter for the figure.
    grid : rows and columns of cells, if they are not the mode's.
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
    grid: GridShape | None = None
    said: str = ""

    @property
    def stands(self) -> str:
        """The fields that determine the bench, as text: captures with equal ones share a bench."""
        bench = self.off_axis, self.perfect, self.f_number, self.grid
        return repr((self.scene, sorted(self.options.items()), bench))


@dataclass(frozen=True, eq=False)
class FigurePhoto:
    """The result of a capture, on a raster of the field: upright, as the projector sees the scene.

    pictures : by their names in the run (`white`, `direct`, the goal ...), answer first; each
        (H, W, C) float32, linear, scene units; NaN where nothing is known.
    truths : the true pictures of the scene, seen through the same optics.
    errors : RMS error of each picture against its truth, relative to the RMS of the truth, over the
        camera's own quads, not the raster, without a narrow border of the field.
    transport, transport_truth : (M, J, C) entries of T for the goal "transport", else None.
    summary : of the run, as in `pdcd capture --json`.
    grid : rows and columns of cells.
    """

    pictures: Mapping[str, Image]
    truths: Mapping[str, Image]
    errors: Mapping[str, float]
    transport: Image | None
    transport_truth: Image | None
    summary: Mapping[str, Any]
    grid: GridShape

    @property
    def answer(self) -> str:
        """Name of the picture that was asked for."""
        return next(iter(self.pictures))

    @property
    def image(self) -> Image:
        """The picture that was asked for, (H, W, C)."""
        return self.pictures[self.answer]

    @property
    def truth(self) -> Image:
        """The truth of that picture, (H, W, C)."""
        return self.truths[self.answer]

    @property
    def error(self) -> float:
        """RMS error of the answer over the RMS of its truth."""
        return self.errors[self.answer]


Photos = Mapping[str, FigurePhoto]


@dataclass(frozen=True, eq=False)
class FigurePanel:
    """One picture of a figure.

    image : (H, W, C) or (H, W); linear light in scene units, or with `kind` "grey" the pixels
        themselves, uint8, drawn by the figure.
    caption : a few words below it.
    white : scene units that are shown as white; None: the row's common value, from the brightest
        hundredth of its first panel.
    signed : 0 is shown as middle grey, as for a difference, which has both signs.
    """

    image: NDArray[Any]
    caption: str
    white: float | None = None
    signed: bool = False
    kind: Literal["light", "grey"] = "light"


@dataclass(frozen=True)
class PanelRow:
    """Panels side by side, on one scale of brightness. title : above them; may be empty. small :
    small pictures, for many rows."""

    panels: tuple[FigurePanel, ...]
    title: str = ""
    small: bool = False

    @classmethod
    def of(cls, pictures: Mapping[str, Image], captions: Mapping[str, str], title: str) -> PanelRow:
        """Some of the pictures of a photo, by their names, with a caption each."""
        return cls(
            tuple(FigurePanel(pictures[name], words) for name, words in captions.items()), title
        )


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a plot. style : as in matplotlib: "-", "--", "o-", "x" ... colour : a number in the
    palette, or a name. label : in the legend; "" is none."""

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    style: str = "-"
    colour: int | str = 0


@dataclass(frozen=True, eq=False)
class FigurePlot:
    """Lines over each other. name : part of the file's. x, y : labels of the axes, with units.

    scales : of x and y, as in matplotlib; "symlog" is linear below a thousandth.
    marks : places along x, each with a word or none. level : a thin line across.
    band : a shaded range along x. y_range : None at an end lets the lines decide.
    """

    name: str
    title: str
    x: str
    y: str
    caption: str
    lines: tuple[Line, ...]
    scales: tuple[str, str] = ("linear", "linear")
    marks: tuple[tuple[float, str], ...] = ()
    level: float | None = None
    band: tuple[float, float] | None = None
    x_from: float | None = None
    y_range: tuple[float | None, float | None] = (None, None)


class BoundedNumber(msgspec.Struct, frozen=True):
    """One figure with the bounds that were stated before it was measured.

    what : in words, with the unit. value : None for NaN. least, most : bounds, both included; None
    is no bound. paper : the number as printed in the paper, if it prints one. percent : shown as a
    percentage. held : whether the value lies within its bounds, computed here; NaN does not.
    """

    what: str
    value: float | None
    least: float | None = None
    most: float | None = None
    paper: str = ""
    percent: bool = False
    held: bool = False

    def __post_init__(self) -> None:
        """Make the values plain numbers, and compare them with the bounds."""
        for name in ("value", "least", "most"):
            told = getattr(self, name)
            known = told is not None and math.isfinite(told)
            msgspec.structs.force_setattr(self, name, float(told) if known else None)
        held = (
            self.value is not None
            and (self.least is None or self.value >= self.least)
            and (self.most is None or self.value <= self.most)
        )
        msgspec.structs.force_setattr(self, "held", held)


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper.

    number : the name to ask for it: "1", "table-1", "appendix".
    see : one sentence on what to see. paper : what the paper took, with its codes and exposure.
    unlike : what still differs from the paper's figure; empty if nothing does.
    takes : mode -> captures by name. shown : mode and photos by the same names -> what is shown,
    in any order of kinds. The table of captures, with their errors and bounds, is added.
    """

    number: str
    title: str
    see: str
    paper: str
    unlike: str
    takes: Callable[[FigureMode], Mapping[str, FigureTake]]
    shown: Callable[[FigureMode, Photos], Iterator[PanelRow | FigurePlot | BoundedNumber]]


def count_independent_codes(count: int) -> int:
    """Independent codes in `count` codes of the paper's counting, which all figures use."""
    return max(count // PRINTED, 1)


LIKE_THE_PAPER: Mapping[str, Any] = {"window": "quarter", "guards": "full", "black_level": "mask"}
"""Panels driven as in the paper: quarter windows, three refreshes a code, and a second photo with a
black mask for what leaks through it. 512 printed codes then take 25.6 s a photo."""
_PAPERS_CODES: Mapping[str, Any] = {
    **LIKE_THE_PAPER,
    "family": "bernoulli",
    "smooth": False,
    "normalise": "scalar",
    "pilot": 0,
    "parts": 1,
}
"""The paper's codes: coins, and one number for the whole photo to divide it by."""
_OUR_CODES: Mapping[str, Any] = {**LIKE_THE_PAPER, "pilot": 0, "parts": 1}
"""The same light, time and number of codes, with our default codes and decoding."""
CODERS: Mapping[str, tuple[Mapping[str, Any], str]] = {
    "ours": (_OUR_CODES, "our codes"),
    "paper": (_PAPERS_CODES, "the paper's codes"),
}
"""Our codes and the paper's: the fields of a request for them, and their name in words."""


def take_coded(
    by: str,
    scene: str,
    goal: GoalName,
    printed: int,
    asked: Mapping[str, Any] | None = None,
    *,
    said: str = "{}",
    **fields: Any,
) -> FigureTake:
    """A capture with the codes of one of `CODERS`.

    printed : codes, as the paper counts them. asked : further fields of the request. said : `{}` in
    it becomes the name of the codes. fields : other fields of `FigureTake`.
    """
    codes, words = CODERS[by]
    whole = {**codes, "codes": count_independent_codes(printed), **(asked or {})}
    return FigureTake(scene, goal, whole, said=said.format(words), **fields)
