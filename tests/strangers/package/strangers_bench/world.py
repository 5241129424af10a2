"""The bench itself: photos of what the panels showed, and the pictures that are true.

Each quad of the sensor looks at the mask at sixteen points. At each, the light of the scene has
been blurred: the points see sixteen places of the scene, laid out so that every place within the
quad meets every offset of the blur equally often (an orthogonal array of sixteen runs). What a
point sees is summed over time with what the mask lets through there.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from .facts import CAMERAS, Facts
from .panels import Course, Ints, Picture, delays_s, follow, sort_pixels, time_steps
from .places import Place
from .scene import Scene

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

SUB = 4
ELSEWHERE = 0.001
"""Share of a quad's light that may come from beside the mask."""
STEPS_FEW, STEPS_MANY = 12, 6
"""Steps of time in a refresh, where pixels are of few kinds, and where they are of many."""
BANDS_MOST, BANDS_LEAST, LABELS = 240, 20, 2400
"""Bands of rows of a panel: as many as make so many labels, within limits."""
MANY = 60
"""Kinds from which they are many."""
CHUNK = 1024
TABLE = 40_000_000


@dataclass
class Stands:
    """What the judge changes between photos; lengths in pixels of the projector."""

    stands: str = "card"
    mask_shift_px: tuple[float, float] = (0.0, 0.0)
    mask_turn_deg: float = 0.0
    mask_mirrored: bool = False
    stretch: float = 1.0
    """Exposures last so many times as long, by a shutter that closes late."""
    says_s: float | None = None
    """The exposure that files tell of, where they do not tell the true one."""
    room_later: float | None = None
    """The room's light from photo `room_after` on, counted since this was written."""
    room_after: int = 0

    def save(self, path: Path) -> None:
        """Write it for the drivers, which look at each photo."""
        path.write_text(json.dumps(self.__dict__))

    @classmethod
    def load(cls, path: Path) -> Stands:
        """Read it; as by default where there is no such file."""
        return cls(**json.loads(path.read_text())) if path.exists() else cls()


@dataclass(frozen=True, eq=False)
class Shown:
    """What both panels were sent: times in s, and which picture (-1: black)."""

    projector_s: Floats
    projector: Ints
    mask_s: Floats
    mask: Ints
    projector_pictures: list[Picture] = field(default_factory=list)
    mask_pictures: list[Picture] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class _Points:
    """The sixteen points of all quads."""

    source: Floats  # (n, 2) scene points
    source_px: Ints  # (n,) pixel of the projector that lights it
    mask_px: Ints  # (n,)
    lit: Singles  # (n,) light of white on it; 0 beyond projector or mask
    room: Singles  # (n,)
    albedo: Singles  # (n, 3)


class World:
    """A bench and what stands before it."""

    def __init__(self, facts: Facts, stands: Stands | None = None) -> None:
        self.facts = facts
        self.stands = stands or Stands()
        self.frame, *_ = CAMERAS[facts.camera]
        size_px = facts.projector.size_px
        self.camera_place = Place(facts.camera_place, self.frame, size_px)
        place = facts.mask_place
        moved = self.stands
        self.mask_place = Place(
            replace(
                place,
                turn_deg=place.turn_deg + moved.mask_turn_deg,
                offset_px=(
                    place.offset_px[0] + moved.mask_shift_px[0],
                    place.offset_px[1] + moved.mask_shift_px[1],
                ),
                mirrored=place.mirrored != moved.mask_mirrored,
            ),
            facts.mask.size_px,
            size_px,
        )
        name = "card" if moved.stands == "card" else facts.scene
        self.scene = Scene(name, facts.seed, size_px)
        self._points = self._looked_at()
        self._strands = self._followed()
        self._vignette = self._darkened()

    # Photos

    def expose(self, shown: Shown, begin_s: float, end_s: float, room: float) -> Floats:
        """Light on the sensor in an exposure, (h, w, 3): 1 is a second of a perfect white in the
        middle of the projector's light through a mask that is not there.

        room : light of the room on the scene in the middle, in the same unit a second.
        """
        points = self._points
        projector_px, projector = self._course(shown, 0)
        mask_px, mask = self._course(shown, 1)
        many = max(projector.course.target.shape[0], mask.course.target.shape[0]) > MANY
        step_s = 1.0 / 60.0 / (STEPS_MANY if many else STEPS_FEW)
        starts = np.union1d(shown.projector_s, shown.mask_s)
        times = time_steps(starts, begin_s, end_s, step_s, *self._settles_s())
        lit, through = projector_px[points.source_px], mask_px[points.mask_px]
        pairs, number = _pairs(lit, through, mask.size)
        strands = self._strands
        if strands is not None:
            index, source_px, weight = strands
            more, more_number = _pairs(projector_px[source_px], through[index], mask.size)
            pairs = np.concatenate([pairs, more])
        tents = self._tent_shares(projector_px, projector.size)
        both, open_s, tents_s = _summed(projector, mask, pairs, tents, times)
        light = points.lit * both[: len(both) - len(more) if strands is not None else None][number]
        light += (room * points.room) * open_s[through]
        if strands is not None:
            light[index] += weight * both[len(both) - len(more) :][more_number]
        if tents_s is not None:
            self._add_tents(light, tents_s, through)
        return self._on_sensor(light)

    def take(self, shown: Shown, begin_s: float, end_s: float, f_true: float, room: float,
             rng: np.random.Generator) -> NDArray[np.uint16]:  # fmt: skip
        """The samples of a photo, (2 h, 2 w), RGGB."""
        facts = self.facts
        _, bits, black, white, gain, read_e, full_e = CAMERAS[facts.camera]
        light = self.expose(shown, begin_s, end_s, room)
        electrons = light * np.array(facts.responsivity_e) / f_true**2
        mosaic = np.empty((2 * light.shape[0], 2 * light.shape[1]))
        for row, col, colour in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
            mosaic[row::2, col::2] = electrons[..., colour]
        count = mosaic + np.sqrt(mosaic) * rng.standard_normal(mosaic.shape)
        few = mosaic < 500.0
        count[few] = rng.poisson(mosaic[few])
        count = np.minimum(count, full_e)
        count += read_e * facts.read_noise * rng.standard_normal(mosaic.shape)
        samples = np.rint(black + count / (gain * facts.gain))
        return np.clip(samples, 0, min(white, 2**bits - 1)).astype(np.uint16)

    # Truth

    def true_pictures(self, cells: NDArray[np.int64], grid: tuple[int, int]) -> dict[str, Floats]:
        """White light a second without a mask, by where it fell on the scene first, (h, w, 3) each.

        cells : (pixels,) cell of each pixel of the projector on a grid (row-major), or -1 where it
            is never lit.

        "direct": straight from the projector. All other light was scattered; the cell on which it
        fell first is the cell of the point that sends it to the camera ("own"), one of the eight
        round it ("near") or any other ("far"). With codes of one value a cell, "own" cannot be
        told from direct light: the indirect picture of such codes is "near" + "far".
        """
        points = self._points
        here = cells[points.source_px]
        lit = cells >= 0
        light = {"direct": points.lit * lit[points.source_px]}
        for name in ("own", "near", "far"):
            light[name] = np.zeros(len(here), dtype=np.float32)
        if self._strands is not None:
            index, source_px, weight = self._strands
            there, at = cells[source_px], here[index]
            rank = _apart(there, at, grid)
            for number, name in enumerate(("own", "near", "far")):
                light[name][index] += weight * ((rank == number) & (there >= 0))
        if self.scene.sees is not None:
            self._true_tents(light, cells, here, grid)
        return {name: self._on_sensor(one.astype(np.float32)) for name, one in light.items()}

    def mask_seen(self) -> NDArray[np.bool_]:
        """Quads all of whose light comes through the mask from the projector's picture, but for a
        thousandth that the camera's blur brings from elsewhere, (h, w)."""
        width, height = self.frame
        inside = (self._points.lit.reshape(height, width, SUB**2) > 0.0).mean(axis=-1)
        return np.asarray(gaussian_filter(inside, self.facts.blur_quads) > 1.0 - ELSEWHERE)

    # Inside

    def _looked_at(self) -> _Points:
        width, height = self.frame
        i, j = (a.ravel() for a in np.meshgrid(np.arange(SUB), np.arange(SUB)))
        # Means of the four quarters of a bell, with its own spread; two squares that are Latin, and
        # orthogonal, as addition and multiplication are in the field of four elements.
        nodes = np.array([-1.3703, -0.35, 0.35, 1.3703])
        twice = np.array([0, 2, 3, 1])
        shift = self.facts.blur_px * np.stack([nodes[i ^ j], nodes[i ^ twice[j]]], axis=1)
        y, x = (a.ravel() for a in np.mgrid[0:height, 0:width])
        within = (np.stack([i, j], axis=1) + 0.5) / SUB
        looks = (np.stack([x, y], axis=1)[:, None, :] + within).reshape(-1, 2)
        at = self.camera_place.to_scene(looks)
        source = (at.reshape(-1, SUB**2, 2) + shift).reshape(-1, 2)
        mask_px, on_mask = _pixel(self.mask_place.from_scene(at), self.facts.mask.size_px)
        source_px, on_chart = _pixel(source, self.facts.projector.size_px)
        size = np.array(self.facts.projector.size_px)
        tilt = self.facts.room_tilt * (source[:, 0] / size[0] - 0.5)
        return _Points(
            source, source_px, mask_px,
            (self._white(source) * on_mask * on_chart).astype(np.float32),
            ((1.0 + tilt) * on_mask).astype(np.float32),
            self.scene.albedo(source).astype(np.float32),
        )  # fmt: skip

    def _white(self, source: Floats) -> Floats:
        """Light of the projector's white on scene points, 1 in the middle."""
        size = np.array(self.facts.projector.size_px)
        apart = np.sum(((source - size / 2.0) / (size / 2.0)) ** 2, axis=-1) / 2.0
        return np.asarray(1.0 - self.facts.falloff * np.clip(apart, 0.0, 1.5))

    def _followed(self) -> tuple[Ints, Ints, Singles] | None:
        """Points that get light by strands, the pixel that lights its other end, and weight."""
        strands = self.scene.strands(self._points.source)
        if strands is None:
            return None
        source_px, lit = _pixel(strands.source, self.facts.projector.size_px)
        on_mask = self._points.room[strands.index] > 0.0
        weight = strands.weight * self._white(strands.source) * lit * on_mask
        return strands.index, source_px, weight.astype(np.float32)

    def _darkened(self) -> Floats:
        width, height = self.frame
        y, x = np.mgrid[0:height, 0:width] + 0.5
        apart = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / (
            (width / 2) ** 2 + (height / 2) ** 2
        )
        return np.asarray((1.0 - self.facts.vignetting * apart)[..., None])

    def _on_sensor(self, light: Singles) -> Floats:
        width, height = self.frame
        by_quad = light.reshape(-1, SUB**2)
        albedo = self._points.albedo.reshape(-1, SUB**2, 3)
        seen = np.einsum("qs,qsc->qc", by_quad, albedo).astype(np.float64) / SUB**2
        seen = seen.reshape(height, width, 3)
        blurred = gaussian_filter(seen, (self.facts.blur_quads, self.facts.blur_quads, 0.0))
        return np.asarray(blurred * self._vignette)

    def _settles_s(self) -> tuple[float, float]:
        """How long after a picture was sent the last rows have begun to follow, and settled."""
        panels = self.facts.projector, self.facts.mask
        slowest = max(max(p.rise_s, p.fall_s) for p in panels)
        late = max(p.late_s + abs(p.scan_s) for p in panels)
        return late + slowest, late + 9.0 * slowest

    def _course(self, shown: Shown, side: int) -> tuple[Ints, _Labelled]:
        """Which label each pixel of a panel has, and what pixels of a label show in time."""
        facts = (self.facts.projector, self.facts.mask)[side]
        pictures = (shown.projector_pictures, shown.mask_pictures)[side]
        at_s = (shown.projector_s, shown.mask_s)[side]
        numbers = (shown.projector, shown.mask)[side]
        width, height = facts.size_px
        if not pictures:
            pictures = [np.zeros((height, width), dtype=np.uint8)]
        kind, levels = sort_pixels(pictures)
        course = follow(facts, at_s, numbers, levels)
        bands = int(np.clip(LABELS // len(levels), BANDS_LEAST, min(BANDS_MOST, height)))
        band = np.repeat(np.arange(height) * bands // height, width)
        label = kind * bands + band
        present = np.zeros(len(levels) * bands, dtype=np.bool_)
        present[label] = True
        used = np.flatnonzero(present)
        number = np.zeros(present.size, dtype=np.int64)
        number[used] = np.arange(used.size)
        return number[label], _Labelled(course, used // bands, used % bands, delays_s(facts, bands))

    def _tent_shares(self, projector_px: Ints, labels: int) -> Singles | None:
        """How much pixels of each label light each tent, (tents, labels)."""
        if self.scene.sees is None:
            return None
        shares = self._pixel_tents()
        return np.stack([np.bincount(projector_px, s, labels) for s in shares]).astype(np.float32)

    def _pixel_tents(self) -> Floats:
        """How much each pixel of the projector lights each tent, (tents, pixels)."""
        width, height = self.facts.projector.size_px
        y, x = (a.ravel() for a in np.mgrid[0:height, 0:width] + 0.5)
        points = np.stack([x, y], axis=1)
        tents = self.scene.tents(points)
        grey = self.scene.albedo(points).mean(axis=1) * self._white(points)
        return np.asarray((tents / tents.sum(axis=0) * grey[:, None]).T)

    def _add_tents(self, light: Singles, tents_s: Singles, through: Ints) -> None:
        """Add what comes off other parts; tents_s (tents, mask labels) is their light in time."""
        sees = self.scene.sees
        assert sees is not None
        arrives = (sees @ tents_s).astype(np.float32)
        middle = self._points.source.reshape(-1, SUB**2, 2).mean(axis=1)
        near = self.scene.tents(middle).astype(np.float32)
        on_mask = self._points.room > 0.0
        for number, one in enumerate(arrives):
            light += np.repeat(near[:, number], SUB**2) * one[through] * on_mask

    def _true_tents(self, light: dict[str, Any], cells: Ints, here: Ints,
                    grid: tuple[int, int]) -> None:  # fmt: skip
        sees = self.scene.sees
        assert sees is not None
        lit = cells >= 0
        count = grid[0] * grid[1]
        shares = self._pixel_tents()
        by_cell = np.stack([np.bincount(cells[lit], s[lit], count) for s in shares])
        pad = by_cell.reshape(len(shares), *grid)
        pad = np.pad(pad, ((0, 0), (1, 1), (1, 1)))
        block = sum(pad[:, i : i + grid[0], j : j + grid[1]] for i in range(3) for j in range(3))
        near = np.asarray(block).reshape(len(shares), -1) - by_cell
        far = by_cell.sum(axis=1, keepdims=True) - near - by_cell
        cell = np.maximum(here, 0)
        middle = self._points.source.reshape(-1, SUB**2, 2).mean(axis=1)
        tents = np.repeat(self.scene.tents(middle).astype(np.float32), SUB**2, axis=0)
        on_mask = self._points.room > 0.0
        for name, table in (("own", by_cell), ("near", near), ("far", far)):
            arrives = (sees @ table).astype(np.float32)
            light[name] += np.einsum("nk,kn->n", tents, arrives[:, cell]) * on_mask


@dataclass(frozen=True, eq=False)
class _Labelled:
    """Pixels of one kind in one band of rows have one label."""

    course: Course
    kind: Ints
    band: Ints
    delays: Floats

    @property
    def size(self) -> int:
        return len(self.kind)

    def light(self, edges_s: Floats) -> Singles:
        """Light of all labels in steps of time between edges (J + 1,), (labels, 2 J).

        The light of two in one step is, to the slope, the product of their means times the step
        and a twelfth of that of their growths: that of the numbers that stand here, summed.
        """
        steps_s = np.diff(edges_s)
        one, other = 1.0 / np.sqrt(steps_s), np.sqrt(steps_s / 12.0)
        found = np.empty((self.size, 2 * steps_s.size), dtype=np.float32)
        for band in np.unique(self.band):
            mine = np.flatnonzero(self.band == band)
            total, grew = self.course.steps(self.kind[mine], float(self.delays[band]), edges_s)
            found[mine, : steps_s.size] = total * one
            found[mine, steps_s.size :] = grew * other
        return found


def _pixel(points: Floats, size_px: tuple[int, int]) -> tuple[Ints, NDArray[np.bool_]]:
    """The pixel that each point falls in, and whether there is one (else the pixel is 0)."""
    x, y = np.floor(points[:, 0]).astype(np.int64), np.floor(points[:, 1]).astype(np.int64)
    inside = (x >= 0) & (x < size_px[0]) & (y >= 0) & (y < size_px[1])
    return np.where(inside, y * size_px[0] + x, 0), inside


def _pairs(one: Ints, other: Ints, others: int) -> tuple[Ints, Ints]:
    """Different pairs of labels (P,) as one number each, and which of them each point has."""
    key = one * others + other
    top = int(key.max(initial=0)) + 1
    if top > TABLE:
        found, number = np.unique(key, return_inverse=True)
        return found, number.ravel()
    present = np.zeros(top, dtype=np.bool_)
    present[key] = True
    found = np.flatnonzero(present)
    number = np.zeros(top, dtype=np.int32)
    number[found] = np.arange(found.size)
    return found, number[key]


def _apart(one: Ints, other: Ints, grid: tuple[int, int]) -> Ints:
    """0: the same cell; 1: neighbours; 2: neither."""
    rows = abs(one // grid[1] - other // grid[1])
    cols = abs(one % grid[1] - other % grid[1])
    return np.asarray(np.minimum(np.maximum(rows, cols), 2))


def _summed(
    projector: _Labelled, mask: _Labelled, pairs: Ints, tents: Singles | None, edges_s: Floats
) -> tuple[Singles, Singles, Singles | None]:  # fmt: skip
    """Sums over time: of both panels' light for pairs (P,), of the mask's alone (labels,), and of
    the mask's with the tents' light (tents, labels)."""
    lit, through = pairs // mask.size, pairs % mask.size
    order = np.argsort(lit, kind="stable")
    lit, through = lit[order], through[order]
    bounds = np.searchsorted(lit, np.arange(projector.size + 1))
    both = np.zeros(len(pairs))
    open_s = np.zeros(mask.size)
    tents_s = None if tents is None else np.zeros((len(tents), mask.size))
    for start in range(0, edges_s.size - 1, CHUNK):
        edges = edges_s[start : start + CHUNK + 1]
        shone, let = projector.light(edges), mask.light(edges)
        for label in np.flatnonzero(np.diff(bounds)):
            mine = slice(bounds[label], bounds[label + 1])
            both[mine] += let[through[mine]] @ shone[label]
        steps_s = np.diff(edges)
        open_s += let[:, : steps_s.size] @ np.sqrt(steps_s)
        if tents is not None and tents_s is not None:
            tents_s += (tents @ shone) @ let.T
    unsorted = np.empty_like(both)
    unsorted[order] = both
    single = np.float32
    return (
        unsorted.astype(single), open_s.astype(single),
        None if tents_s is None else tents_s.astype(single),
    )  # fmt: skip
