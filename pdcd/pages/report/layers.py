"""The pictures of a page: sampled on the field as previews are, rounded, packed.

A page shows the field as the projector sees it. A picture that the camera saw more finely than
`MOST_REPORT_PX` is shrunk by area: a pixel then is the mean of several quads, and its sigma that of
the mean, as far as it is noise of the sensor; the error of the codes is shared by neighbours and
stays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Singles
from pdcd.pages.report.packing import choose_step, pack_linear, pack_logarithmic
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.upright import FieldSampler, FieldView, find_known_pixels
from pdcd.pictures.written.looks import (
    WHITE_PICTURE,
    Brightness,
    ToneStats,
    balance_of,
    choose_pixel_step,
    compute_median_sigma,
)
from pdcd.runs.record import RunRecord
from pdcd.sensor.bands import THREADS

MOST_REPORT_PX = 1068
"""Widest picture of a page: half of what a body of twelve million samples sees."""
MOST_PIXELS = 3_100_000
"""Of all pictures of a page together, the truth included; each takes about four bytes."""
MOST_PICTURES = 8
"""Pictures of a page; the answer is the first."""
_STEPS_A_SIGMA = 2.0
"""Steps of a picture within the usual noise of the sensor: rounding adds 1 % to that."""
_FINEST = 2.0**-14
"""... but no finer than that share of its brightest value."""
LARGE_PX = 2**18
"""Pixels from which every second row and column of sigma is kept."""
_NEARLY = 0.3
"""Of a quad, by which squares of quads may be wider than a pixel of a page."""
_KIND = "picture"


@dataclass(frozen=True)
class AnswerTruth:
    """What the answer is in truth, on the camera's quads: (h, w, C) in scene units, and where it
    can be compared, (h, w)."""

    image: NDArray[np.floating]
    seen: Bools


@dataclass(frozen=True)
class Layers:
    """Pictures of a page, packed.

    data : what the page has of each. size_px : width and height. quads : to a pixel. scale : what a
    scene unit is shown as at a factor of 1. balance : factors of the colours; only for the
    eyes. left_out : names of pictures for which there was no room.
    """

    data: list[dict[str, Any]]
    size_px: tuple[int, int]
    quads: float
    scale: float
    balance: tuple[float, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class _Seen:
    """On the field: image (H, W, C), NaN where nothing is known, and its sigma, infinite there;
    `noise` is the usual error by the sensor alone."""

    image: Singles
    sigma: Singles
    known: Bools
    noise: float

    def look(self, factors: tuple[float, ...]) -> ToneStats:
        """What decides on its brightness, once it is balanced."""
        some = (slice(None, None, choose_pixel_step(self.known)),) * 2
        image, known = self.image[some] * np.array(factors, np.float32), self.known[some]
        return ToneStats.of(image, known, compute_median_sigma(self.sigma[some], known))


def pack_layers(
    pictures: Mapping[str, PictureWithErrors],
    view: FieldView,
    truth: AnswerTruth | None,
    side: int = 1,
) -> Layers:
    """Pack the first `MOST_PICTURES`, the answer first, and the answer's truth after them.

    side : quads of the camera that one of the pictures is the mean of, each way.
    """
    size_px = choose_layer_size(len(pictures), view)
    sampler = FieldSampler(view, size_px)
    across, down = view.quads()
    quads = max(across / size_px[0], down / size_px[1], 1.0) ** 2
    names = _chosen(list(pictures))
    seen = _sampled({name: pictures[name] for name in names}, sampler, quads)
    on_field = {name: (one.image, one.known) for name, one in seen.items()}
    balance = balance_of(on_field, view.white_patch).factors
    brightness = Brightness({name: one.look(balance) for name, one in seen.items()})
    jobs: list[tuple[str, str, Singles, Singles | None, float]] = [
        (name, _KIND, one.image, one.sigma, one.noise) for name, one in seen.items()
    ]
    if truth is not None:
        image, there = sampler(truth.image, truth.seen)
        image[~there] = np.nan
        jobs.append((names[0], "truth", image, None, seen[names[0]].noise))
    with ThreadPoolExecutor(THREADS) as pool:
        packed = list(pool.map(lambda job: _packed(*job), jobs))
    for one in packed:
        one["factor"] = brightness.factor(one["name"])
        one["signed"] = brightness.signed(one["name"])
    left_out = tuple(name for name in pictures if name not in names)
    return Layers(packed, size_px, quads * side**2, brightness.scale, balance, left_out)


def choose_bin_side(pictures: int, record: RunRecord) -> int:
    """Quads, each way, whose mean a page of so many pictures of a run can do with: nearly as many
    as make a pixel of it."""
    cells = record.cells
    if cells is None:
        return 1
    view = FieldView.of(record, cells)
    across, down = view.quads()
    width, height = choose_layer_size(pictures, view)
    most = int(max(across / width, down / height, 1.0) + _NEARLY)
    return next(side for side in range(most, 0, -1) if cells.can_bin(side))


def choose_layer_size(pictures: int, view: FieldView) -> tuple[int, int]:
    """(width, height) of so many pictures of a page, and of a truth."""
    each = MOST_PIXELS / (min(pictures, MOST_PICTURES) + 1)
    return view.size_px(1, min(MOST_REPORT_PX, int(math.sqrt(each * view.aspect))))


def _chosen(names: list[str]) -> list[str]:
    """The first ones, and the white one wherever it stands."""
    first = names[:MOST_PICTURES]
    if WHITE_PICTURE in names and WHITE_PICTURE not in first:
        first[-1] = WHITE_PICTURE
    return first


def _sampled(
    pictures: Mapping[str, PictureWithErrors], sampler: FieldSampler, quads: float
) -> dict[str, _Seen]:
    """Pictures of one run; all images before all errors, as a sampler remembers what was known."""
    known = {name: find_known_pixels(one.sigma, one.image) for name, one in pictures.items()}
    images = {name: sampler(one.image, known[name]) for name, one in pictures.items()}
    # Where several quads share a pixel, one of them tells what the error of each is.
    every = slice(None, None, int(math.sqrt(quads) + 0.01))
    found = {}
    for name, one in pictures.items():
        some = np.ascontiguousarray(known[name][every, every])
        variance, _ = sampler(one.sensor[every, every] ** 2, some)
        code, _ = sampler(one.code[every, every], some)
        sensor = np.maximum(variance, np.float32(0.0)) / np.float32(quads)
        sigma: Singles = np.sqrt(sensor + code**2)
        image, seen = images[name]
        image[~seen], sigma[~seen] = np.nan, np.inf
        found[name] = _Seen(image, sigma, seen, math.sqrt(compute_median_sigma(sensor, seen)))
    return found


def _packed(
    name: str, kind: str, image: Singles, sigma: Singles | None, noise: float
) -> dict[str, Any]:
    planes = _planes(image)
    known = planes[np.isfinite(planes)]
    top = float(np.abs(known).max()) if known.size else 0.0
    step = choose_step(planes, max(noise / _STEPS_A_SIGMA, top * _FINEST))
    errors = None
    if sigma is not None:
        every = 2 if sigma[..., 0].size > LARGE_PX else 1
        errors = pack_logarithmic(_planes(sigma[::every, ::every]))
    return {"name": name, "kind": kind, "values": pack_linear(planes, step), "sigma": errors}


def _planes(image: Singles) -> Singles:
    """(H, W, C) -> (C, H, W)."""
    return np.ascontiguousarray(np.moveaxis(image, -1, 0))
