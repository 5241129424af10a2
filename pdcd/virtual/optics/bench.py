"""A mock bench of pixels: what its camera sees, quad by quad.

At a point x of the field, where the projector's pixel passes p and the mask's pixel passes m:

    light(x)  = blur of [ direct(y) p(y, t) + indirect(y, t) ] over y around x
    sensor(x) = integral of m(x, t) (light(x, t) + ambient(x)) dt

The value of a quad is the mean of its samples; the lens then adds blur and vignetting. What is
absent costs nothing. docs/mock-bench.md describes it in full.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import msgspec
import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.tables import Config
from pdcd.bench.truth import BenchTruth, load_bench_truth
from pdcd.panels.frames import PIXEL_WINDOW, Frames, split_dark_times
from pdcd.probing.borders import cell_mismatch_px
from pdcd.probing.wanted import WantedMatrix
from pdcd.virtual.optics.histories import Histories
from pdcd.virtual.optics.lens import Lens
from pdcd.virtual.optics.lit import IlluminatedEffect
from pdcd.virtual.optics.lookup import (
    MOST_PAIRS,
    HistoryTables,
    is_sparse,
    render_by_lookup,
)
from pdcd.virtual.optics.own_cells import CLOSED, OwnCells, find_own_cells
from pdcd.virtual.optics.products import (
    PairTables,
    PanelExposure,
    Products,
    SitePairs,
    find_distinct_pairs,
)
from pdcd.virtual.optics.render import Detail, PictureTerms, Renderer
from pdcd.virtual.optics.sent import compute_sent_light
from pdcd.virtual.optics.setting import OpticalSetting, compute_falloff, find_points_on_field
from pdcd.virtual.optics.sights import (
    CameraSamples,
    CellGrid,
    LightOrigins,
    ScatteredSamples,
    SlantedSamples,
    find_sights,
)
from pdcd.virtual.optics.sites import PanelSites, SiteKind
from pdcd.virtual.optics.spread import LitCellPoints
from pdcd.virtual.scene.displaced import compute_direct_albedo, is_single_bounce
from pdcd.virtual.scene.effects import Array, Effect
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.texture import average_cells

MOST_DRIVES = 3
"""Ways of driving the panels that are kept: for a white shot, for a coded one, for the truth."""


@dataclass(frozen=True)
class _Driven:
    """What follows from the way the panels are driven: the sites of projector and mask, and the
    renderer of pictures seen through them. Without a mask, its site 0 lies in front of everything.
    `spread` (projector sites, N) is the share of each cell that a site lights."""

    lit: PanelSites
    opened: PanelSites
    spread: scipy.sparse.csr_array
    renderer: Renderer


class OpticalBench:
    """A scene, two panels and a camera, wherever they are.

    Parameters
    ----------
    config : what is believed; its `[bench] truth` names what is true.
    scene : the scene on the bench.
    frame : rows and columns of the camera's quads.

    Raises ConfigError for a wrong truth, or a map that cannot be used.
    """

    def __init__(self, config: Config, scene: Scene, frame: tuple[int, int]) -> None:
        setting = OpticalSetting(config, load_bench_truth(config), frame)
        setting.check()
        drawn, size_px = setting.drawn, config.projector.size_px
        apart = cell_mismatch_px(drawn.projector, drawn.mask, config.code_grid(scene.grid), size_px)
        self._setting = replace(setting, apart=apart > 0.0)
        self._scene = scene
        self._kept: OrderedDict[tuple[SiteKind, SiteKind | CellGrid | None], _Driven] = (
            OrderedDict()
        )
        self._lit_kept: OrderedDict[SiteKind, tuple[PanelSites, scipy.sparse.csr_array]] = (
            OrderedDict()
        )

    @property
    def scene(self) -> Scene:
        """The scene on the bench."""
        return self._scene

    @property
    def truth(self) -> BenchTruth:
        """How the bench differs from what is believed."""
        return self._setting.truth

    @property
    def true(self) -> Config:
        """The configuration that describes the bench as it is."""
        return self._setting.true

    @property
    def frame(self) -> tuple[int, int]:
        """Rows and columns of the camera's quads."""
        return self._setting.frame

    def photo(self, exposure: PanelExposure) -> Floats:
        """Light of one exposure at the quads, (rows, cols, 3) in scene units times seconds."""
        frames = exposure.frames
        exposure = replace(exposure, log=split_dark_times(exposure.log))
        lit, opened = (
            _kind(frames, bool(len(patterns)))
            for patterns in (frames.primal_patterns, frames.dual_patterns)
        )
        whole = self._whole(exposure, lit, opened) if frames.of_pixels else None
        if whole is not None:
            finely = self._setting.slanted and is_sparse(frames)
            return self._lens.through(self._looked_up(whole, self._room(exposure), finely))
        driven = self._driven(lit, opened)
        tables = self._tables(driven, exposure)
        room = self._room(exposure)
        ambient = None if room is None else (tables.open_s, room)
        albedo = compute_direct_albedo(self._scene.effects, self._scene.cells)
        return self._image(driven, tables.direct, albedo, tables.indirect, ambient)

    def _whole(
        self, exposure: PanelExposure, lit: SiteKind, opened: SiteKind
    ) -> HistoryTables | None:
        """The tables of all pairs of histories; None where there are too many pairs. What is sent
        is divided by the means of textures."""
        projector, spread = self._lit(lit)
        truth, true = self.truth, self.true
        mask = PanelSites(self._setting.drawn.mask, opened, truth.mask, true.mask)
        frames, effects, cells = exposure.frames, self._indirect, self._scene.cells
        primal = Histories(projector, frames, mask=False)
        dual = Histories(mask, frames, mask=True)
        count = len(dual)
        if max(count * len(primal), count * cells * bool(effects)) > MOST_PAIRS:
            return None
        light = primal.spread(spread)
        products = Products(true, primal, dual, exposure, light, effects)
        tables, means = products.all_tables(), self._means
        if effects and means is not None:
            tables.indirect[:] /= means[1]  # in place: it is the largest table of all
        return HistoryTables(
            mask=dual.of[mask.image].astype(np.int32),
            projector=primal.of[projector.image].astype(np.int32),
            beside=int(dual.of[0]),
            seconds=tables.direct,
            sent=tables.indirect if effects else None,
            open_s=tables.open_s,
            uneven=self._uneven,
        )

    def _looked_up(self, whole: HistoryTables, room: Floats | None, finely: bool) -> Floats:
        """The picture of panels whose pixels have few histories; room : ambient light, (N, 3).
        finely : whether strips much narrower than a quad are seen at their true width."""
        direct, means = compute_direct_albedo(self._scene.effects, self._scene.cells), self._means
        if means is not None:
            direct = direct / means[0]
        scene = (direct,) if room is None else (direct, room)
        textures = self._scene.textures
        setting = self._setting if finely else self._of_pixels
        looks = self._looks if finely else self._scattered
        return render_by_lookup(setting, looks, self._cells, whole, scene, textures)

    def _tables(self, driven: _Driven, exposure: PanelExposure) -> PairTables:
        """For how long sites were lit and open, and the indirect light that came of it."""
        met, frames, effects = driven.renderer.met, exposure.frames, self._indirect
        if not frames.of_pixels:
            products = Products(
                self.true, driven.lit, driven.opened, exposure, driven.spread, effects
            )
            return products.tables(met.direct, met.indirect)
        lit = Histories(driven.lit, frames, mask=False)
        opened = Histories(driven.opened, frames, mask=True)
        light = lit.spread(driven.spread)
        products = Products(self.true, lit, opened, exposure, light, effects)
        direct, of_direct = find_distinct_pairs(met.direct, opened.of, lit.of)
        indirect, of_indirect = find_distinct_pairs(met.indirect, opened.of, None)
        few = products.tables(direct, indirect)
        return PairTables(few.direct[of_direct], few.indirect[of_indirect], few.open_s[opened.of])

    def wanted(
        self,
        answer: Callable[[Scene], Array],
        meant: WantedMatrix | None = None,
        alive: Callable[[], None] = lambda: None,
        *,
        grid: tuple[int, int] | None = None,
    ) -> Floats:
        """The true picture, computed from the scene, through the same optics, (rows, cols, 3).

        `answer` computes the picture of a scene, cell by cell, (N, 3) in scene units; it is linear
        in the scene's effects. The mask is taken away; the projector stays as uneven as it is.
        A quad whose blur reaches beyond the field gets only what it sees of the field.

        meant : the wanted matrix of the picture. A place between the centres of two cells gets
            the light of both, but it lies in one of them, and that cell's row applies there.
            Without `meant`, and off the axis, the light of each cell counts as seen from that cell.
        grid : rows and columns of the cells of the codes, those of `meant`; None: the scene's.
        alive : called now and then; it may raise to end the work.
        """
        own = None if meant is None else self._own(grid)
        if meant is not None and (own is not None or self._between):
            return self._wanted_of_places(meant, own, alive)
        scene, kind = self._scene, SiteKind(self._scene.grid, "whole", False)
        driven = self._driven(kind, None)
        lit = np.asarray(driven.spread[1:].sum(axis=0)).ravel()
        wandered = tuple(IlluminatedEffect(effect, lit) for effect in self._indirect)
        met = driven.renderer.met
        full = (met.direct.other > 0).astype(np.float64)
        sent = answer(Scene(scene.name, scene.grid, wandered))[met.indirect.other]
        reflected = answer(Scene(scene.name, scene.grid, self._straight))
        return self._unshared(self._image(driven, full, reflected, sent, None), None)

    def _wanted_of_places(
        self, meant: WantedMatrix, own: OwnCells | None, alive: Callable[[], None]
    ) -> Floats:
        """What is wanted of each place according to the cell that it lies in: a cell of the codes'
        `own` or, where that is None, of the scene."""
        scene = self._scene
        grid = scene.grid if own is None else own.grid
        kind = SiteKind(grid, "whole", False)
        driven = self._driven(kind, CellGrid(grid, smooth=False) if own is None else own)
        met, first = driven.renderer.met, 0 if own is None else CLOSED + 1
        if own is None:
            light = scipy.sparse.diags_array(driven.spread[1:].sum(axis=0)).tocsr()
        else:
            light = self._cells_lit(grid)
        wandered = Scene(scene.name, scene.grid, self._indirect)
        pairs = SitePairs(np.maximum(met.indirect.mask - first, 0), met.indirect.other)
        sent = compute_sent_light(wandered, pairs, meant, light, alive)
        sent[met.indirect.mask < first] = 0.0
        weight = meant.uniform[0] if meant.uniform else None
        cell = np.maximum(met.direct.mask - first, 0)
        full = np.where((met.direct.other > 0) & (met.direct.mask >= first), 1.0, 0.0)
        full *= meant.diagonal()[cell] if weight is None else weight
        reflected = Scene(scene.name, scene.grid, self._straight).split()[0]
        return self._unshared(self._image(driven, full, reflected, sent, None), own)

    def tells(self, meant: WantedMatrix, grid: tuple[int, int]) -> bool:
        """Whether `wanted` can compute what codes of this grid mean. Off the axis it can only if
        they fill the projector's whole picture and either have the scene's cells or want the same
        of every cell."""
        if self._scene.displacement is None:
            return True
        whole = self._setting.believed.projector.field_px is None
        return whole and (grid == self._scene.grid or meant.uniform is not None)

    def _own(self, grid: tuple[int, int] | None) -> OwnCells | None:
        """The codes' own cells; None where they are the scene's cells, or off the axis."""
        if grid is None or self._scene.displacement is not None:
            return None
        return find_own_cells(self._setting, self._scene.grid, grid)

    def _cells_lit(self, grid: tuple[int, int]) -> scipy.sparse.csr_array:
        """Share of each scene cell that each cell of codes lights, (cells, N)."""
        drawn, true = self._setting.drawn.projector, self.true.projector
        at_once = msgspec.structs.replace(true, scan_s=0.0)
        sites = PanelSites(drawn, SiteKind(grid, "whole", True), self.truth.projector, at_once)
        return self._spread(sites)[1:]

    @property
    def _between(self) -> bool:
        """Whether places between the centres of cells have the light of both."""
        return self._scene.textures is not None and self._scene.displacement is None

    def _unshared(self, image: Floats, own: OwnCells | None) -> Floats:
        """The picture as if quads saw nothing but the field: divided by their share of it."""
        share = self.share if own is None else self._lens.share_of(own.inside)
        return image if share is None else image / np.where(share > 0.0, share, 1.0)[..., None]

    @property
    def share(self) -> Floats | None:
        """Share of each quad's light that comes from the field (`pdcd.virtual.optics.lens`)."""
        return self._lens.share

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """Which quads lie wholly inside the field, (rows, cols)."""
        return self.inside_of(None)

    def inside_of(self, grid: tuple[int, int] | None) -> NDArray[np.bool_]:
        """Which quads lie wholly inside the field of codes of this grid, (rows, cols); None: of the
        scene's grid."""
        rows, cols = self.frame
        corners = np.stack(np.meshgrid(np.arange(cols + 1.0), np.arange(rows + 1.0)), axis=-1)
        places, own = self._setting.camera.to_field(corners), self._own(grid)
        good = find_points_on_field(places)
        if own is not None:
            good &= own.inside(places)
        return np.asarray(good[1:, 1:] & good[1:, :-1] & good[:-1, 1:] & good[:-1, :-1])

    @property
    def _straight(self) -> tuple[Effect, ...]:
        return tuple(effect for effect in self._scene.effects if is_single_bounce(effect))

    @property
    def _indirect(self) -> tuple[Effect, ...]:
        return tuple(effect for effect in self._scene.effects if not is_single_bounce(effect))

    def _room(self, exposure: PanelExposure) -> Array | None:
        """Ambient light of the cells in an exposure, (N, 3), where there is any."""
        said = self.truth.scene.ambient
        if said is None or exposure.lights_off:
            return self._scene.ambient
        return np.full((self._scene.cells, 3), said) if said else None

    @cached_property
    def _cells(self) -> CellGrid:
        return CellGrid(self._scene.grid, self._scene.textures is not None)

    @cached_property
    def _means(self) -> tuple[Array, Array] | None:
        """Means of the scene's textures over its cells, (N, 3) each."""
        textures, grid = self._scene.textures, self._scene.grid
        return textures and (average_cells(textures[0], grid), average_cells(textures[1], grid))

    @cached_property
    def _lens(self) -> Lens:
        return Lens(self._setting)

    @cached_property
    def _looks(self) -> CameraSamples:
        kind = SlantedSamples if self._setting.slanted else CameraSamples
        return kind(self._setting, self._away)

    @cached_property
    def _of_pixels(self) -> OpticalSetting:
        """For most pictures of the panels' own pixels, which have no borders of cells."""
        return replace(self._setting, apart=False)

    @cached_property
    def _scattered(self) -> CameraSamples:
        return ScatteredSamples(self._of_pixels, self._away)

    @property
    def _away(self) -> LightOrigins | None:
        moved = self._scene.displacement
        return None if moved is None else LightOrigins(self._scene.grid, moved)

    @cached_property
    def _uneven(self) -> Floats | None:
        return compute_falloff(self.truth.projector.falloff, self.true.projector.size_px)

    def _image(
        self,
        driven: _Driven,
        direct: Floats,
        reflected: Floats,
        indirect: Floats,
        ambient: tuple[Floats, Floats] | None,
    ) -> Floats:
        """The picture on the sensor. The tables are those of `PictureTerms`, before they are
        divided by the means of textures."""
        means = self._means
        if means is not None:
            reflected = reflected / means[0]
            indirect = indirect / means[1][driven.renderer.met.indirect.other]
        terms = PictureTerms(direct, reflected, indirect, ambient)
        return self._lens.through(driven.renderer.render(terms))

    def _driven(self, lit: SiteKind, opened: SiteKind | CellGrid | None) -> _Driven:
        """What is seen when the panels are driven this way. `opened` is None without a mask; a
        grid stands for a mask that opens whole cells."""
        key = lit, opened
        if key not in self._kept:
            drawn, truth = self._setting.drawn, self.truth
            projector, spread = self._lit(lit)
            kind = opened if isinstance(opened, SiteKind) else lit
            mask = PanelSites(drawn.mask, kind, truth.mask, self.true.mask)
            before = mask if isinstance(opened, SiteKind) else opened
            sights = find_sights(self._looks, self._setting, self._cells, projector, before)
            renderer = Renderer(
                self._setting,
                self._looks,
                self._cells,
                sights,
                Detail(self._scene.textures, self._uneven),
                ambient=self._scene.ambient is not None or bool(self.truth.scene.ambient),
            )
            self._kept[key] = _Driven(projector, mask, spread, renderer)
            while len(self._kept) > MOST_DRIVES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def _lit(self, kind: SiteKind) -> tuple[PanelSites, scipy.sparse.csr_array]:
        """The projector's sites when it is driven this way, and their spread."""
        if kind not in self._lit_kept:
            drawn, true = self._setting.drawn.projector, self.true.projector
            sites = PanelSites(drawn, kind, self.truth.projector, true)
            self._lit_kept[kind] = sites, self._spread(sites)
            while len(self._lit_kept) > MOST_DRIVES:
                self._lit_kept.popitem(last=False)
        self._lit_kept.move_to_end(kind)
        return self._lit_kept[kind]

    @cached_property
    def _cell_light(self) -> LitCellPoints:
        return LitCellPoints.of(self._setting, self._scene.grid)

    def _spread(self, sites: PanelSites) -> scipy.sparse.csr_array:
        """Share of each scene cell that each site of the projector lights, (sites, N)."""
        if not self._indirect:
            return scipy.sparse.csr_array((len(sites), self._scene.cells))
        return self._cell_light.by_site(sites, self._uneven)


def _kind(frames: Frames, patterned: bool) -> SiteKind:
    """How a panel is driven that shows patterns of these frames, or no patterns."""
    if frames.of_pixels:
        return SiteKind((0, 0), PIXEL_WINDOW, patterned)
    return SiteKind(frames.grid, frames.window if patterned else "whole", patterned)
