"""A bench that is turned, keystoned, bent, blurred and noisy, photographed sample by sample.

Nothing of the estimators is used. Each quad is looked at in `samples` x `samples` points; each
point has a place on the projector and one on the mask, both by the bench's true maps. Light there:
what the projector's stripes give, blurred by a Gaussian (error functions at their edges), times
what the mask's pixel there lets through, averaged over the refreshes. Then the relay's blur, the
mean over the quad, and the noise of a camera.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline
from scipy.special import ndtr

from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import PanelSequence, make_still_sequence
from pdcd.panels.frames import BLACK, WHITE
from pdcd.panels.map import Map, map_between

Floats = NDArray[np.float64]

READ_E = 16.8
T_S = 1.0 / 60.0


def lens(size_px: tuple[int, int], seed: int, bend: float, turn_deg: float, scale: float) -> Map:
    """A device that looks at the field a little turned, keystoned and bent."""
    rng = np.random.default_rng(seed)
    angle = np.radians(turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    to_px = np.diag([4.0 / 3.0, 1.0])
    full = np.eye(3)
    full[:2, :2] = scale * np.linalg.inv(to_px) @ turn @ to_px
    full[2, :2] = rng.uniform(-0.02, 0.02, 2)
    middle = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    nodes = rng.normal(0.0, 0.4, (4, 5, 2))
    map_ = Map.filling(size_px).then(np.linalg.inv(middle) @ full @ middle)
    return msgspec.structs.replace(
        map_,
        radial=(bend, 0.0),
        residual=tuple(tuple((r, d) for r, d in row) for row in nodes.tolist()),
    )


def misplaced(map_: Map, projector_px: tuple[int, int], seed: int, px: float) -> Map:
    """The map as somebody believes it who is wrong by about so many projector pixels."""
    rng = np.random.default_rng(seed)
    wrong = np.eye(3)
    wrong[:2, 2] = rng.uniform(-px, px, 2) / projector_px
    wrong[:2, :2] += rng.uniform(-px, px, (2, 2)) / max(projector_px)
    moved = map_.then(wrong)
    if not map_.residual:
        return moved
    nodes = np.array(map_.residual) + rng.normal(0.0, 0.03 * px, np.shape(map_.residual))
    return msgspec.structs.replace(
        moved, residual=tuple(tuple((r, d) for r, d in row) for row in nodes.tolist())
    )


@dataclass
class RulerBench:
    """The bench. blur_px : of the light on the mask, in projector pixels, right and down.

    electrons : of a white quad. leak : of the closed mask. rise_s, fall_s : of the mask.
    """

    projector_px: tuple[int, int] = (256, 192)
    mask_px: tuple[int, int] = (400, 300)
    frame: tuple[int, int] = (300, 225)
    seed: int = 0
    blur_px: tuple[float, float] = (0.5, 0.5)
    relay_quads: float = 0.7
    electrons: float = 20_000.0
    leak: float = 0.002
    ambient: float = 0.02
    samples: int = 2
    taus_s: tuple[float, float] = (0.0, 0.0)
    camera: Map = field(init=False)
    mask: Map = field(init=False)

    def __post_init__(self) -> None:
        self.projector = Map.filling(self.projector_px)
        self.camera = lens(self.frame, self.seed + 1, 0.03, 1.0, 1.06)
        self.mask = lens(self.mask_px, self.seed + 2, -0.01, -0.7, 1.05)
        self.rng = np.random.default_rng(self.seed)
        self.albedo = np.ones(self.frame[::-1])
        self.kept: tuple[bytes, Floats] = (b"", np.empty(0))
        self.look()

    def look(self) -> None:
        """Find out what each sample sees; again after a map has changed."""
        width, height = self.frame
        every = 6.0
        coarse = [np.arange(-every, side + 2.0 * every, every) for side in (width, height)]
        fine = [(np.arange(n * self.samples) + 0.5) / self.samples for n in (width, height)]
        seen = self.camera.to_field(np.stack(np.meshgrid(*coarse), axis=-1))

        def everywhere(places: Floats) -> Floats:
            # Between points of a lattice, by splines: maps are smooth, and Newton's method is slow.
            across = [
                RectBivariateSpline(*coarse[::-1], places[..., axis])(*fine[::-1])
                for axis in (0, 1)
            ]
            return np.stack(across, axis=-1)

        self.kept = (b"", np.empty(0))
        self.on_projector = everywhere(self.projector.from_field(seen))
        on_mask = np.floor(everywhere(self.mask.from_field(seen)))
        inside = np.asarray(((on_mask >= 0) & (on_mask < self.mask_px)).all(axis=-1))
        self.pixel = np.where(inside[..., None], on_mask, 0.0).astype(np.int64)
        self.inside = inside

    def photo(self, shown: PanelSequence, lamp: float = 1.0, exposure: float = 1.0) -> QuadPhoto:
        """A photo; light in electrons for a bench whose white gives `electrons`."""
        light, shares = self._projected(shown), self._mask(shown)
        through, room = (
            np.where(self.inside, each[self.pixel[..., 1], self.pixel[..., 0]], 0.0)
            for each in shares
        )
        image = lamp * light * through + self.ambient * room
        image = ndimage.gaussian_filter(image, self.relay_quads * self.samples)
        width, height = self.frame
        quads = image.reshape(height, self.samples, width, self.samples).mean(axis=(1, 3))
        electrons = quads * self.albedo * self.electrons * exposure
        variance = 0.5 * (electrons + READ_E**2)
        noisy = electrons + self.rng.normal(size=electrons.shape) * np.sqrt(variance)
        believed = 0.5 * (np.maximum(noisy, 0.0) + READ_E**2)
        colours = (*noisy.shape, 3)
        return QuadPhoto(*(np.broadcast_to(each[..., None], colours) for each in (noisy, believed)))

    def white(self, refreshes: int = 8) -> QuadPhoto:
        """Both panels white."""
        return self.photo(make_still_sequence("white", refreshes, WHITE, WHITE))

    def offset_px(self, mask: Map, points_px: Floats) -> Floats:
        """Where a map has pixels of the mask, less where they are, in projector pixels."""
        return map_between(mask, self.projector, points_px) - map_between(
            self.mask, self.projector, points_px
        )

    def seen_points(self, apart: int = 7) -> Floats:
        """Pixels of the mask all over the part of the projector's picture that the camera sees."""
        x, y = (np.arange(0.5, side, apart) for side in self.mask_px)
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        quads = map_between(self.mask, self.camera, points)
        on_field = self.mask.to_field(points)
        good = ((quads > 0) & (quads < self.frame) & (on_field > 0) & (on_field < 1)).all(axis=-1)
        return points[good]

    def _projected(self, shown: PanelSequence) -> Floats:
        """Light of the projector at each sample, while it is lit."""
        white = shown.projector_index.min() == WHITE
        key = b"white" if white else np.packbits(shown.projector[0]).tobytes()
        if self.kept[0] != key:
            self.kept = (key, self._stripes(shown, white))
        return self.kept[1]

    def _stripes(self, shown: PanelSequence, white: bool) -> Floats:
        if white:
            lines: list[Floats] = [np.ones(side) for side in self.projector_px]
        else:
            pattern = shown.projector[0].astype(np.float64)
            lines = [pattern.max(axis=0), pattern.max(axis=1)]
            assert np.array_equal(pattern, np.outer(lines[1], lines[0]))
        light = np.ones(self.inside.shape)
        for axis, line in enumerate(lines):
            at = np.arange(-16.0, line.size + 16.0, 1.0 / 64.0)
            profile = np.zeros(at.size)
            edges = np.diff(np.concatenate([[0.0], line, [0.0]]))
            for edge in np.flatnonzero(edges):
                profile += edges[edge] * ndtr((at - edge) / self.blur_px[axis])
            light *= np.interp(self.on_projector[..., axis], at, profile)
        return light

    def _mask(self, shown: PanelSequence) -> tuple[Floats, Floats]:
        """Mean of the mask over the time that the projector is lit, and over all time."""
        width, height = self.mask_px
        # Negative numbers of patterns: WHITE is the last but one, BLACK the last.
        assert (WHITE, BLACK) == (-2, -1)
        whole = np.ones((height, width))
        patterns = [*shown.mask.astype(np.float64), whole, 0.0 * whole]
        targets = [self.leak + (1.0 - self.leak) * each for each in patterns]
        lit = shown.projector_index != BLACK
        if not any(self.taus_s):
            mean = sum(targets[index] for index in shown.mask_index[lit]) / max(1, lit.sum())
            every = sum(targets[index] for index in shown.mask_index) / lit.size
            return np.asarray(mean), np.asarray(every) * lit.size / max(1, lit.sum())
        return self._slow(shown, targets)

    def _slow(self, shown: PanelSequence, targets: list[Floats]) -> tuple[Floats, Floats]:
        """The same of panels that answer slowly, both alike, in eighths of a refresh."""
        rise, fall = self.taus_s
        state, lamp = np.full_like(targets[0], self.leak), 0.0
        light = np.zeros_like(state)
        pieces, dark = 8, np.full(3, BLACK)
        step = T_S / pieces
        for index, on in zip(
            np.append(shown.mask_index, dark), np.append(shown.projector_index, dark), strict=True
        ):
            up, aim = targets[index] > state, float(on != BLACK)
            keep = np.where(up, np.exp(-step / rise), np.exp(-step / fall))
            hold = np.exp(-step / (rise if aim > lamp else fall))
            for _ in range(pieces):
                after = targets[index] + (state - targets[index]) * keep
                shine = aim + (lamp - aim) * hold
                light += 0.5 * (state + after) * 0.5 * (lamp + shine)
                state, lamp = after, shine
        count = np.count_nonzero(shown.projector_index != BLACK) * pieces
        return light / count, light / count
