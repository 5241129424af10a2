"""The pictures of a page: sampled on the field as previews are, rounded, packed.

A page shows the field as the projector sees it. A picture wider than `MOST_REPORT_PX` is shrunk by
area: a pixel is then the mean of several quads. The sensor's noise in its sigma is that of the
mean; the error of the codes stays, as neighbours share it.
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
"""Widest picture of a page: half the width in quads of a body with twelve million samples."""
MOST_PIXELS = 3_100_000
"""Most pixels of all pictures of a page, the truth included; each takes about four bytes."""
MOST_PICTURES = 8
"""Most pictures of a page; the answer is the first."""
_STEPS_A_SIGMA = 2.0
"""Steps of a picture within the usual noise of the sensor: rounding adds 1 % to that noise."""
_FINEST = 2.0**-14
"""Smallest step, as a share of the picture's brightest value."""
LARGE_PX = 2**18
"""Pixels from which on only every second row and column of sigma is kept."""
_NEARLY = 0.3
"""Part of a quad by which squares of quads may be wider than a pixel of a page."""
_KIND = "picture"


@dataclass(frozen=True)
class AnswerTruth:
    """The truth of the answer on the camera's quads, (h, w, C) in scene units, and where it can be
    compared, (h, w)."""

    image: NDArray[np.floating]
    seen: Bools


@dataclass(frozen=True)
class Layers:
    """Pictures of a page, packed.

    data : the page's data of each. size_px : width and height. quads : in a pixel. scale : how
    bright a scene unit is shown at a factor of 1. balance : factors of the colours, for display
    only. left_out : names of pictures for which there was no room.
    """

    data: list[dict[str, Any]]
    size_px: tuple[int, int]
    quads: float
    scale: float
    balance: tuple[float, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class _Seen:
    """A picture on the field: image (H, W, C), NaN where it is not known, and its sigma, infinite
    there; `noise` is the usual error by the sensor alone."""

    image: Singles
    sigma: Singles
    known: Bools
    noise: float

    def look(self, factors: tuple[float, ...]) -> ToneStats:
        """The balanced values that decide how bright it is shown."""
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

    side : quads of the camera, each way, whose mean is one pixel of the pictures.
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
    """Quads, each way, that can be averaged for a page of this many pictures: nearly as many as
    make up one of its pixels."""
    cells = record.cells
    if cells is None:
        return 1
    view = FieldView.of(record, cells)
    across, down = view.quads()
    width, height = choose_layer_size(pictures, view)
    most = int(max(across / width, down / height, 1.0) + _NEARLY)
    return next(side for side in range(most, 0, -1) if cells.can_bin(side))


def choose_layer_size(pictures: int, view: FieldView) -> tuple[int, int]:
    """(width, height) of the pictures of a page with this many pictures and a truth."""
    each = MOST_PIXELS / (min(pictures, MOST_PICTURES) + 1)
    return view.size_px(1, min(MOST_REPORT_PX, int(math.sqrt(each * view.aspect))))


def _chosen(names: list[str]) -> list[str]:
    """The first names, and the white picture's wherever it is."""
    first = names[:MOST_PICTURES]
    if WHITE_PICTURE in names and WHITE_PICTURE not in first:
        first[-1] = WHITE_PICTURE
    return first


def _sampled(
    pictures: Mapping[str, PictureWithErrors], sampler: FieldSampler, quads: float
) -> dict[str, _Seen]:
    """Pictures of one run on the field; all images before all errors, as a sampler remembers which
    quads were known."""
    known = {name: find_known_pixels(one.sigma, one.image) for name, one in pictures.items()}
    images = {name: sampler(one.image, known[name]) for name, one in pictures.items()}
    # Where several quads share a pixel, one of them gives the error of each.
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
