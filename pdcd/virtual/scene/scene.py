"""A virtual scene: a sum of effects on a grid of cells, and what a camera sees of it."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.effects import Array, Cells, Effect
from pdcd.virtual.scene.texture import Drawing


class _OnFirstUse:
    """An attribute of a scene: a texture that is given, or drawn at its first use."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._given, self._drawn = f"_{name}", f"_{name}_drawn"

    def __get__(self, scene: Scene | None, owner: type) -> Array | None:
        if scene is None:
            return None  # the default of the dataclass
        given: Array | Drawing | None = vars(scene)[self._given]
        if not callable(given):
            return given
        if self._drawn not in vars(scene):
            vars(scene)[self._drawn] = given()
        drawn: Array = vars(scene)[self._drawn]
        drawn.flags.writeable = False  # scenes of other grids may share it
        return drawn

    def __set__(self, scene: Scene, given: Array | Drawing | None) -> None:
        vars(scene)[self._given] = given


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene with known light transport ``T = sum_e tint_e T_e``.

    name : str
    grid : (rows, cols)
        Cells, one of the projector and one of the camera each; N = rows * cols, row-major.
    effects : tuple of Effect
        The parts of its transport; an effect that is absent costs nothing.
    ambient : (N, 3) float64 or None
        Light at the camera that is not the projector's, in scene units; None: there is none.
    texture : (H, W, 3) float64, positive, or None
        Detail finer than cells, see `pdcd.virtual.scene.texture`; None: a cell is of one value. It
        may be given as a function without arguments, which is called when the texture is first
        asked for.
    indirect_texture : as `texture`, or None
        Detail of the indirect light where it is not that of the surface: light that comes out of
        wax or milk knows nothing of the scratches and letters that direct light shows. None: the
        same as `texture`.
    """

    name: str
    grid: tuple[int, int]
    effects: tuple[Effect, ...]
    ambient: Array | None = None
    texture: _OnFirstUse = _OnFirstUse()
    indirect_texture: _OnFirstUse = _OnFirstUse()

    def __getstate__(self) -> dict[str, Any]:
        """The state for another process, which draws textures anew where they can be drawn."""
        return {name: value for name, value in vars(self).items() if not name.endswith("_drawn")}

    def under(self, ambient: Array) -> Scene:
        """Return the scene with this ambient light, (N, 3), without drawing any texture."""
        lit = copy.copy(self)
        object.__setattr__(lit, "ambient", ambient)
        return lit

    @property
    def textures(self) -> tuple[Array, Array] | None:
        """Textures of the direct and of the indirect light, (H, W, 3) each; None: no detail."""
        direct, indirect = self.texture, self.indirect_texture
        if direct is None:
            return None
        return direct, direct if indirect is None else indirect

    @property
    def cells(self) -> int:
        """Number of cells N."""
        return self.grid[0] * self.grid[1]

    def apply(self, light: Array) -> Array:
        """Return what the camera sees, (B, N, 3), under B illuminations `light` (B, N).

        Ambient light is left out, so the result is linear in `light`.
        """
        seen = np.zeros((*light.shape, 3))
        for effect in self.effects:
            seen += effect.apply(light)[..., None] * effect.tint
        return seen

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """Return entries of T from cells `lit` to cells `seen`, (P,) each: (P, 3)."""
        found = np.zeros((seen.size, 3))
        for effect in self.effects:
            found += effect.entries(seen, lit)[:, None] * effect.tint
        return found

    def white(self) -> Array:
        """Return the scene under full white light, ``T 1`` (N, 3)."""
        seen: Array = self.apply(np.ones((1, self.cells)))[0]
        return seen

    def split(self) -> tuple[Array, Array]:
        """Return the true direct and indirect images, (N, 3) each; their sum is `white`.

        Direct is the diagonal of the whole T: it holds every path that ends in the cell it
        started from, also those inside a medium (row 1 of Table 2 of the paper).
        """
        direct = np.zeros((self.cells, 3))
        for effect in self.effects:
            direct += effect.diagonal()[:, None] * effect.tint
        return direct, self.white() - direct

    def dense(self) -> Array:
        """Return T for each channel, (3, N, N); for small grids only."""
        whole = np.zeros((3, self.cells, self.cells))
        for effect in self.effects:
            whole += effect.tint[:, None, None] * effect.dense()
        return whole

    @property
    def displacement(self) -> Array | None:
        """Where direct light comes from, beside the cell that sees it, (N, 2) cells down and right;
        None on a coaxial bench (`pdcd.virtual.scene.displaced`)."""
        found = [e.displacement for e in self.effects if isinstance(e, DisplacedEffect)]
        return found[0] if found else None

    def photo(
        self,
        left: Array,
        right: Array,
        coaxial: Array,
        open_s: Array,
        displaced: Array | None = None,
    ) -> Array:
        """Return what one exposure collects, (N, 3): ``(P o T) 1`` plus the ambient light.

        Parameters
        ----------
        left, right : (R, N) float64
            The realised probing matrix between cells, ``P = left^T right``, in seconds.
        coaxial : (N,) float64
            Time for which direct light passed at each cell, in seconds. It replaces the diagonal
            of P for effects that return light at the very point it fell on, because panels that
            open parts of a cell treat such light differently from light that wandered.
        open_s : (N,) float64
            Time for which the mask let ambient light through, in seconds.
        displaced : (N,) float64 or None
            As `coaxial`, for direct light from `displacement`. None: by the matrix between cells,
            which is the same where panels show whole cells.

        Notes
        -----
        The result is additive: the sum over R may be done in chunks, with `coaxial` and `open_s`
        given once and zero in all other calls.
        """
        seen = np.zeros((self.cells, 3))
        for effect in self.effects:
            if effect.coaxial:
                share = effect.diagonal() * coaxial
            elif displaced is not None and isinstance(effect, DisplacedEffect):
                share = effect.albedo * displaced
            else:
                share = effect.probe(left, right)
            seen += share[:, None] * effect.tint
        if self.ambient is not None:
            seen += self.ambient * open_s[:, None]
        return seen
