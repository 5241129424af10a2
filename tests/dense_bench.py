"""A mock bench evaluated densely, from first principles: every pixel of both panels has a history
of its own, every pair of them an integral, every sample of the camera a look at both.

Nothing of `pdcd.probing`, `pdcd.virtual.optics`, or of the lattice and atoms of `pdcd.panels` is
used; maps are (their own tests hold them against OpenCV's formulas).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.map import Map
from tests.oracles import GUARDS

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DensePanel:
    """One panel: where it is believed to lie and where it lies, and how it answers."""

    mask: bool
    believed: Map
    true: Map
    rise_s: float = 0.0
    fall_s: float = 0.0
    leak: float = 0.0
    skew_s: float = 0.0
    gamma: float = 1.0
    lut: tuple[float, ...] | None = None
    scan_s: float = 0.0
    bands: int = 1
    falloff: float = 0.0
    dead_rows: tuple[int, ...] = ()
    dead_columns: tuple[int, ...] = ()

    def shown(self, frames: Frames, row: int) -> Floats:
        """Light that each pixel is asked for at a row of the frames, (pixels,); -1 is black."""
        width, height = self.true.size_px
        index = frames.dual_index if self.mask else frames.primal_index
        which = -1 if row < 0 else int(index[row])
        out = np.zeros((height, width))
        centres = self.believed.centres()
        for y in range(height):
            for x in range(width):
                u, v = centres[y, x]
                dead = y in self.dead_rows or x in self.dead_columns
                if frames.window == "pixels":
                    if which != -1 and not dead:
                        out[y, x] = 1.0 if which == -2 else self._own(frames, which, x, y)
                    continue
                if which == -1 or dead or not (0.0 <= u < 1.0 and 0.0 <= v < 1.0):
                    continue
                out[y, x] = 1.0 if which == -2 else self._level(frames, row, which, u, v)
        return out.ravel()

    def _level(self, frames: Frames, row: int, which: int, u: float, v: float) -> float:
        (rows, cols), shift = frames.grid, int(frames.shift[row])
        across = u * cols + 0.5 * (shift & 1)
        down = v * rows + 0.5 * (shift >> 1)
        guard = GUARDS.get(frames.window)
        if self.mask and guard:
            for place in (across, down):
                if not guard <= place - np.floor(place) < 1.0 - guard:
                    return 0.0
        patterns = frames.dual_patterns if self.mask else frames.primal_patterns
        cell = int(down) * frames.lattice[1] + int(across)
        if patterns.dtype == np.uint8:
            return float(np.unpackbits(patterns[which])[cell])
        return self._given(float(np.rint(patterns[which][cell] * 255.0)) / 255.0)

    def _given(self, sent: float) -> float:
        """Light of a level over 255: a power, or straight lines between the lights of a table."""
        if self.lut is None:
            return float(sent**self.gamma)
        at = sent * (len(self.lut) - 1)
        low = min(int(at), len(self.lut) - 2)
        return (low + 1 - at) * self.lut[low] + (at - low) * self.lut[low + 1]

    def _own(self, frames: Frames, which: int, x: int, y: int) -> float:
        """A pixel of a picture of the panel's own pixels."""
        patterns = frames.dual_patterns if self.mask else frames.primal_patterns
        at = y * self.true.size_px[0] + x
        if patterns.dtype == np.uint8:
            return float(np.unpackbits(patterns[which])[at])
        return self._given(float(np.rint(patterns[which][at] * 255.0)) / 255.0)

    @property
    def row_of_pixel(self) -> NDArray[np.int64]:
        width, height = self.true.size_px
        return np.repeat(np.arange(height), width)

    @property
    def delays_ns(self) -> NDArray[np.int64]:
        """By how much each row of pixels is late, whole ns."""
        height = self.true.size_px[1]
        bands = min(self.bands, height) if self.scan_s else 1
        delays = []
        for row in range(height):
            band = row * bands // height
            if self.scan_s < 0.0:
                band = bands - 1 - band
            share = band / (bands - 1) if bands > 1 else 0.0
            delays.append(round(1e9 * (self.skew_s + 0.0)) + round(1e9 * abs(self.scan_s) * share))
        return np.array(delays)

    def at(self, points: Floats) -> NDArray[np.int64]:
        """Pixel under points of the field (n, 2); -1 beside the panel."""
        width, height = self.true.size_px
        place = self.true.from_field(points)
        good = np.asarray(np.isfinite(place).all(axis=1))
        x, y = np.floor(np.where(good[:, None], place, -1.0)).astype(np.int64).T
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        return np.where(inside, y * width + x, -1)


@dataclass(frozen=True)
class History:
    """One panel between times t[k] and t[k + 1], pixel by pixel: level + (state - level) e^-t/tau.

    level, state, tau : (K, pixels)
    """

    level: Floats
    state: Floats
    tau: Floats


def edges_ns(panel: DensePanel, stamps: NDArray[np.int64], end_ns: int, open_ns: int) -> set[int]:
    """All times at which any row of a panel changes."""
    found: set[int] = set()
    for delay in panel.delays_ns:
        found |= {int(t) + int(delay) for t in [*stamps, end_ns]}
    return found


def history(
    panel: DensePanel,
    frames: Frames,
    shown: NDArray[np.int32],
    stamps: NDArray[np.int64],
    end_ns: int,
    times: NDArray[np.int64],
) -> History:
    """What the pixels of a panel do between these times; they rest on black at the first."""
    contents = np.stack([panel.shown(frames, int(row)) for row in [-1, *shown, -1]])
    late = panel.delays_ns[panel.row_of_pixel]
    state = np.full(panel.row_of_pixel.size, panel.leak)
    levels, states, taus = [], [], []
    ends = [*stamps.tolist(), end_ns]
    for k in range(len(times) - 1):
        reached = np.zeros(state.size, dtype=np.int64)
        for number, at in enumerate(ends):
            reached[at + late <= times[k]] = number + 1
        asked = contents[reached, np.arange(state.size)]
        level = panel.leak + (1.0 - panel.leak) * asked
        tau = np.where(level >= state, panel.rise_s, panel.fall_s)
        start = np.where(tau > 0.0, state, level)
        levels.append(level)
        states.append(start)
        taus.append(tau)
        passed_s = (times[k + 1] - times[k]) * 1e-9
        fade = np.exp(-passed_s / np.where(tau > 0.0, tau, 1.0))
        state = level + np.where(tau > 0.0, (start - level) * fade, 0.0)
    return History(np.array(levels), np.array(states), np.array(taus))


def products_s(mask: History, light: History, times: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Integral of mask times light, (mask pixels, projector pixels), and of the mask, (pixels,)."""
    whole = np.zeros((mask.level.shape[1], light.level.shape[1]))
    alone = np.zeros(mask.level.shape[1])
    for k in range(len(times) - 1):
        t = (times[k + 1] - times[k]) * 1e-9
        a, b = mask.level[k][:, None], light.level[k][None, :]
        c = (mask.state[k] - mask.level[k])[:, None]
        d = (light.state[k] - light.level[k])[None, :]
        rate_c = 1.0 / np.where(mask.tau[k] > 0.0, mask.tau[k], 1.0)[:, None]
        rate_d = 1.0 / np.where(light.tau[k] > 0.0, light.tau[k], 1.0)[None, :]
        fade_c, fade_d = faded(rate_c, t), faded(rate_d, t)
        whole += a * b * t + a * d * fade_d + c * b * fade_c + c * d * faded(rate_c + rate_d, t)
        alone += (a * t + c * fade_c)[:, 0]
    return whole, alone


def faded(rate: Floats, t: float) -> Floats:
    return -np.expm1(-rate * t) / rate


@dataclass(frozen=True)
class DenseBench:
    """The whole bench. transport (3, N, N) without direct light, direct (N, 3); `texture` (H, W, 3)
    of both, or None; blur in taps: offsets on the field and shares; scattered : whether
    samples lie off their raster."""

    projector: DensePanel
    mask: DensePanel
    camera: Map
    grid: tuple[int, int]
    direct: Floats
    transport: Floats
    samples: int
    ambient: float = 0.0
    texture: Floats | None = None
    mask_seen_at: tuple[float, float] = (0.0, 0.0)
    taps: list[tuple[tuple[float, float], float]] = field(default_factory=lambda: [((0, 0), 1.0)])
    blur_quads: float = 0.0
    vignetting: float = 0.0
    scattered: bool = False

    def photo(self, frames: Frames, log: FrameLog, open_ns: int, close_ns: int) -> Floats:
        edges = edges_ns(self.projector, log.primal_ns, int(log.end_ns[0]), open_ns)
        edges |= edges_ns(self.mask, log.dual_ns, int(log.end_ns[1]), open_ns)
        inner = {t for t in edges if open_ns < t < close_ns}
        times = np.array(sorted(inner | {open_ns, close_ns}))
        light = history(
            self.projector, frames, log.primal_shown, log.primal_ns, int(log.end_ns[0]), times
        )
        opened = history(self.mask, frames, log.dual_shown, log.dual_ns, int(log.end_ns[1]), times)
        together, alone = products_s(opened, light, times)
        together = together * uneven(self.projector)[None, :]
        # Behind each mask pixel: the light on each cell, and what the scene makes of it.
        on_cells = together @ self._lit_share().T
        sent = np.einsum("cnl,jl->jnc", self.transport, on_cells)
        return self._lens(self._samples(together, sent, alone))

    def _lit_share(self) -> Floats:
        """(N, projector pixels): share of each cell's points that lie in each pixel."""
        rows, cols = self.grid
        width, height = self.projector.true.size_px
        points = 2 * max(-(-width // cols), -(-height // rows))
        share = np.zeros((rows * cols, width * height))
        for row in range(rows):
            for col in range(cols):
                inner = (np.arange(points) + 0.5) / points
                x, y = np.meshgrid((col + inner) / cols, (row + inner) / rows)
                pixel = self.projector.at(np.stack([x.ravel(), y.ravel()], axis=1))
                np.add.at(share[row * cols + col], pixel[pixel >= 0], 1.0 / points**2)
        return share

    def _samples(self, together: Floats, sent: Floats, alone: Floats) -> Floats:
        width, height = self.camera.size_px
        image = np.zeros((height, width, 3))
        inner = (np.arange(self.samples) + 0.5) / self.samples
        rows, cols = (np.add.outer(np.arange(n), inner).ravel() for n in (height, width))
        # All places in one go: a map takes as long for one point as for a thousand.
        seen = np.stack(np.meshgrid(cols, rows), axis=-1)
        if self.scattered:
            # Each elsewhere in its share of the quad, by steps of the plastic number.
            one = float(np.roots([1.0, 0.0, -1.0, -1.0])[0].real)
            down, right = np.indices(seen.shape[:2])
            seen[..., 0] += ((down / one**2 + right / one) % 1.0 - 0.5) / self.samples
            seen[..., 1] += ((down / one + right / one**2) % 1.0 - 0.5) / self.samples
        # What lies on a border of cells or texels falls to one side of it, whatever is rounded.
        places = self.camera.to_field(seen.reshape(-1, 2) + 1e-9)
        offsets = np.array([offset for offset, _ in self.taps])
        points = places[:, None] + offsets
        masks = self.mask.at(places + np.array(self.mask_seen_at))
        behinds = self.projector.at(points.reshape(-1, 2)).reshape(points.shape[:2])
        for k, (x, mask) in enumerate(zip(places, masks.tolist(), strict=True)):
            row, col = k // cols.size // self.samples, k % cols.size // self.samples
            light = self._sample(x, mask, points[k], behinds[k], together, sent, alone)
            image[row, col] += light
        return image / self.samples**2

    def _sample(
        self,
        x: Floats,
        mask: int,
        points: Floats,
        behind: NDArray[np.int64],
        together: Floats,
        sent: Floats,
        alone: Floats,
    ) -> Floats:
        """Light at a place of the field, seen through that pixel of the mask; behind the mask lie
        the points that the taps take, and those pixels of the projector."""
        dark = len(together) - 1  # a pixel that the test keeps dead: what lies beside is as black
        before = mask if mask >= 0 else dark
        light = np.zeros(3)
        for y, pixel, (_, share) in zip(points, behind, self.taps, strict=True):
            if not ((y >= 0.0) & (y < 1.0)).all():
                continue
            if pixel >= 0:
                light += share * self.reflected(y, self.direct) * together[before, pixel]
            light += share * self.reflected(y, sent[before])
        if ((x >= 0.0) & (x < 1.0)).all():
            light += self.ambient * alone[before]
        return light

    @cached_property
    def _means(self) -> Floats:
        """The mean of the texture over each cell, (N, 3)."""
        (rows, cols), texels = self.grid, self.texture
        assert texels is not None
        height, width = texels.shape[:2]
        assert height % rows == width % cols == 0
        blocks = texels.reshape(rows, height // rows, cols, width // cols, 3)
        return np.asarray(blocks.mean(axis=(1, 3)).reshape(-1, 3))

    def reflected(self, y: Floats, cells: Floats) -> Floats:
        """What cells (N, 3) send from a point of the field, (3,)."""
        rows, cols = self.grid
        if self.texture is None:
            return np.asarray(cells[int(y[1] * rows) * cols + int(y[0] * cols)])
        texels, (height, width) = self.texture, self.texture.shape[:2]
        smooth = (cells / self._means).reshape(rows, cols, 3)
        down = np.clip(y[1] * rows - 0.5, 0.0, rows - 1.0)
        across = np.clip(y[0] * cols - 0.5, 0.0, cols - 1.0)
        r, c = min(int(down), rows - 2), min(int(across), cols - 2)
        f, g = down - r, across - c
        between = (1 - f) * ((1 - g) * smooth[r, c] + g * smooth[r, c + 1])
        between += f * ((1 - g) * smooth[r + 1, c] + g * smooth[r + 1, c + 1])
        return np.asarray(texels[int(y[1] * height), int(y[0] * width)] * between)

    def _lens(self, image: Floats) -> Floats:
        height, width = image.shape[:2]
        if self.blur_quads:
            reach = int(4.0 * self.blur_quads + 0.5)
            weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / self.blur_quads) ** 2)
            weight /= weight.sum()
            # The outermost quads go on beyond the frame, as far as the field does.
            down, right = (np.arange(-reach, size + reach) for size in (height, width))
            rows, cols = (np.clip(n, 0, n.max() - reach) for n in (down, right))
            wide = image[rows][:, cols]
            for r, c in np.argwhere((down != rows)[:, None] | (right != cols)[None, :]):
                ((x, y),) = self.camera.to_field(np.array([[right[c] + 0.5, down[r] + 0.5]]))
                if not (0.0 <= x <= 1.0 and 0.0 <= y <= 1.0):
                    wide[r, c] = 0.0
            for axis, size in ((0, height), (1, width)):
                parts = [
                    w * np.take(wide, np.arange(size) + k, axis=axis) for k, w in enumerate(weight)
                ]
                wide = np.sum(parts, axis=0)
            image = wide
        return image * shade(width, height, self.vignetting).reshape(height, width, 1)


def uneven(panel: DensePanel) -> Floats:
    """Light of each pixel over that of the centre, (pixels,)."""
    return shade(*panel.true.size_px, panel.falloff)


def shade(width: int, height: int, lost: float) -> Floats:
    """1 in the centre, 1 - lost in the corners, by the square of the radius; (pixels,)."""
    far = np.hypot(width / 2, height / 2)
    return np.array(
        [
            1.0 - lost * (np.hypot(x + 0.5 - width / 2, y + 0.5 - height / 2) / far) ** 2
            for y in range(height)
            for x in range(width)
        ]
    )
