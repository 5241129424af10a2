"""A bench of two pulsing panels, a card and a camera, step by step in time and quad by quad.

Nothing of `pdcd.calibration` but what the panels were asked for: the answers of panels are followed
in small steps, so that they need not be exponentials at all; photos have noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import PanelSequence
from pdcd.calibration.timing.timing_model import PhotoLog
from pdcd.panels.frames import WHITE, FrameLog
from pdcd.panels.map import Map

Floats = NDArray[np.float64]

REFRESH_S = 1.0 / 60.0
STEP_S = 1e-4
LEAD_S = 0.06
TRAIL_S = 0.15


@dataclass(frozen=True)
class TruePanel:
    """rise_s, fall_s : of its light; share `tail` of the light is `slower` times as slow."""

    rise_s: float = 0.002
    fall_s: float = 0.002
    leak: float = 0.0
    tail: float = 0.0
    slower: float = 4.0


def followed(panel: TruePanel, asked: Floats, slow: float = 1.0) -> Floats:
    """What a panel does when asked for this (steps, n), from black on, (steps, n)."""
    out, state = np.empty(asked.shape), np.zeros(asked.shape[1])
    up = 1.0 - np.exp(-STEP_S / (panel.rise_s * slow))
    down = 1.0 - np.exp(-STEP_S / (panel.fall_s * slow))
    for k, wanted in enumerate(asked):
        before = state
        state = before + np.where(wanted > before, up, down) * (wanted - before)
        out[k] = 0.5 * (before + state)
    return out


def answered(panel: TruePanel, asked: Floats) -> Floats:
    light = (1.0 - panel.tail) * followed(panel, asked)
    if panel.tail:
        light += panel.tail * followed(panel, asked, panel.slower)
    return light + panel.leak * (1.0 - light)


@dataclass
class Bench:
    """skew_s : of the mask over the projector at y = 0, scan_s : what is added until y = 1.
    across_s : what is added from x = 0 to x = 1, none of it in the middle.

    falls : the projector's white is less by this at the left and right ends of the field.
    electrons : of a quad for white. flat : relative error of each patch of a photo. ambient : light
    on the mask beside the projector's; stray : light that comes past the mask. blur : in quads.
    """

    projector_map: Map
    mask_map: Map
    camera: Map
    projector: TruePanel = field(default_factory=TruePanel)
    mask: TruePanel = field(default_factory=TruePanel)
    skew_s: float = 0.0
    scan_s: float = 0.0
    across_s: float = 0.0
    electrons: float = 20000.0
    flat: float = 5e-4
    ambient: float = 0.0
    falls: float = 0.0
    stray: float = 0.0
    blur: float = 0.7
    covered: float = 1.0
    apart_s: float = 0.0
    slip_s: float = 0.0
    full: float = np.inf
    mask_stays_open: bool = False
    patch: int = 8
    seed: int = 1

    def log(self, shown: PanelSequence) -> PhotoLog:
        """The log of a display that misses nothing; the mask's clock may run a little slower."""
        count = shown.refreshes
        rows = np.arange(count, dtype=np.int32)
        at = 400_000_000 + np.round(np.arange(count + 1) * REFRESH_S * 1e9).astype(np.int64)
        slip = np.linspace(0.0, self.slip_s, count + 1)
        mask = at + np.round((self.apart_s + slip) * 1e9).astype(np.int64)
        log = FrameLog(
            rows, rows, at[:-1], mask[:-1], np.array([at[-1], mask[-1]]),
            np.zeros(count, np.int32), "test", True,
        )  # fmt: skip
        return PhotoLog(log, 0, int(at[-1]) + 600_000_000)

    def photo(self, shown: PanelSequence, photo_seed: int = 0) -> QuadPhoto:
        """What the camera has of it."""
        rng = np.random.default_rng((self.seed, photo_seed))
        centres = self.camera.centres()
        width = centres.shape[1]
        lit, lit_kind = self._kinds(shown.projector, shown.projector_index)
        opened, open_kind = self._kinds(shown.mask, shown.mask_index)
        if self.mask_stays_open:
            opened = np.repeat(opened.any(axis=0, keepdims=True), len(opened), 0).astype(float)
        p = self._under(lit_kind, self.projector_map, centres)
        m = self._under(open_kind, self.mask_map, centres)
        x, y = (np.clip(centres[..., axis], 0.0, 1.0) for axis in (0, 1))
        late_s = self.scan_s * y + self.across_s * (x - 0.5)
        light, glowing = (self._light(lit, opened, p, m, late_s, beside) for beside in (0.0, 1.0))
        shade = 1.0 - self.falls * (2.0 * x - 1.0) ** 2
        light = shade * light + self.ambient * (glowing - light)
        light = np.where(centres[..., 0] < self.covered, light, 0.02 * light)
        light = gaussian_filter(light, self.blur) if self.blur else light
        patches = 1.0 + self.flat * rng.standard_normal((1, 1 + width // self.patch))
        light = light * np.repeat(patches, self.patch, axis=1)[:, :width] + self.stray
        electrons = self.electrons * light[..., None] * np.array([0.8, 1.0, 0.7])
        samples = np.array([1.0, 2.0, 1.0])
        variance = (electrons + 17.0**2) / samples
        noisy = electrons + np.sqrt(variance) * rng.standard_normal(electrons.shape)
        return QuadPhoto(np.minimum(noisy, self.full), variance, (noisy > self.full).any(axis=-1))

    def _kinds(
        self, patterns: NDArray[np.bool_] | NDArray[np.uint8], index: NDArray[np.int32]
    ) -> tuple[Floats, Floats]:
        """Histories (refreshes, kinds) and which of them each pixel has, (height, width)."""
        if patterns.size == 0:
            return (index == WHITE).astype(np.float64)[:, None], np.zeros((1, 1))
        codes = np.tensordot(1 << np.arange(len(patterns)), patterns.astype(np.int64), (0, 0))
        kinds, place = np.unique(codes, return_inverse=True)
        on = (kinds[None, :] >> np.maximum(index, 0)[:, None]) & 1
        on = np.where(index[:, None] < 0, index[:, None] == WHITE, on)
        return on.astype(np.float64), place.reshape(codes.shape).astype(np.float64)

    def _under(self, kind: Floats, map_: Map, centres: Floats) -> NDArray[np.int64]:
        if kind.size == 1:
            return np.zeros(centres.shape[:2], np.int64)
        x = map_.from_field(centres)
        place = [x[..., 1] - 0.5, x[..., 0] - 0.5]
        return np.asarray(map_coordinates(kind, place, order=0, mode="nearest"), dtype=np.int64)

    def _light(
        self,
        lit: Floats,
        opened: Floats,
        p: NDArray[np.int64],
        m: NDArray[np.int64],
        late_s: Floats,
        ambient: float,
    ) -> Floats:
        """Mean of the product over the refreshes, of each quad that is `late_s` beside the skew; by
        17 lags between which it is interpolated."""
        low_s = min(self.scan_s, 0.0) - 0.5 * abs(self.across_s)
        range_s = abs(self.scan_s) + abs(self.across_s)
        lags = low_s + range_s * np.linspace(0.0, 1.0, 17 if range_s else 1)
        pairs, which = np.unique(p * 1000 + m, return_inverse=True)
        table = products(
            self.projector, self.mask, tuple(map(tuple, lit.T)), tuple(map(tuple, opened.T)),
            tuple(pairs.tolist()), tuple((self.skew_s + lags).tolist()),
            ambient, self.apart_s, self.slip_s,
        )  # fmt: skip
        which = which.reshape(p.shape)
        if len(lags) == 1:
            return np.asarray(table[which, 0])
        place = (late_s - low_s) / range_s * (len(lags) - 1)
        low = np.minimum(place.astype(int), len(lags) - 2)
        part = place - low
        return np.asarray((1 - part) * table[which, low] + part * table[which, low + 1])


_FOLLOWED: dict[tuple[TruePanel, tuple[float, ...]], Floats] = {}


def prepare(panel: TruePanel, kinds: Iterable[tuple[float, ...]]) -> None:
    """Follow histories that are not known yet, all at once."""
    new = [kind for kind in dict.fromkeys(kinds) if (panel, kind) not in _FOLLOWED]
    if not new:
        return
    per = round(REFRESH_S / STEP_S)
    before, after = round(LEAD_S / STEP_S), round(TRAIL_S / STEP_S)
    on = np.repeat(np.array(new).T, per, axis=0)
    dark = np.zeros((1, on.shape[1]))
    found = answered(panel, np.vstack([dark.repeat(before, 0), on, dark.repeat(after, 0)]))
    _FOLLOWED.update({(panel, kind): found[:, k] for k, kind in enumerate(new)})


def history(panel: TruePanel, kinds: tuple[tuple[float, ...], ...]) -> Floats:
    prepare(panel, kinds)
    return np.stack([_FOLLOWED[panel, kind] for kind in kinds], axis=1)


@cache
def products(
    projector: TruePanel, mask: TruePanel, lit: tuple[tuple[float, ...], ...],
    opened: tuple[tuple[float, ...], ...], pairs: tuple[int, ...], lags: tuple[float, ...],
    ambient: float, apart_s: float, slip_s: float,
) -> Floats:  # fmt: skip
    """Mean over the refreshes of the product of both panels, (pairs, lags)."""
    count = len(lit[0])
    per = round(REFRESH_S / STEP_S)
    step = REFRESH_S / per
    before = round(LEAD_S / STEP_S)
    light, gate = history(projector, lit), history(mask, opened)
    at = np.arange(len(light)) * step
    out = np.empty((len(pairs), len(lags)))
    drift = slip_s * (at - before * step) / (count * REFRESH_S)
    for j, lag in enumerate(lags):
        later = np.clip((at - lag - apart_s - drift) / step, 0, len(at) - 1.001)
        low = later.astype(int)
        part = (later - low)[:, None]
        shifted = (1 - part) * gate[low] + part * gate[low + 1]
        both = (light + ambient).T @ shifted * step / (count * REFRESH_S)
        for n, pair in enumerate(pairs):
            out[n, j] = both[pair // 1000, pair % 1000]
    return out
