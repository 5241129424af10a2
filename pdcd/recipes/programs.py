"""How a shot realises its share of a wanted matrix: what both panels show, slot by slot.

A program turns the code bits i (K, L) of a family into P pairs of patterns. The outer products of
its pairs add up to what its docstring says. Light cannot be negative: a program of signed values
has two shots whose difference is wanted (eq. 10 of the paper).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import cv2
import numpy as np

from pdcd.arrays import Bools, Floats, Indices
from pdcd.codes.far import make_long_range_masks
from pdcd.panels.lattice import Lattice
from pdcd.probing.convolved import filter_images
from pdcd.probing.wanted import shift_cells

Levels = Floats | Bools
_L = TypeVar("_L", Floats, Bools)
LevelPairs = tuple[Levels, Levels]
"""Levels 0..1 of projector and mask, (P, L) each."""


class Program(Protocol):
    """What a shot shows.

    A `coded` program needs code bits, lit with probability p, over the lattice of the rig's window
    mode. Others show their levels over the grid's own cells, through whole cells.
    """

    @property
    def coded(self) -> bool:
        """Whether `pairs` uses the bits."""
        ...

    @property
    def p(self) -> float:
        """Share of codes in which a cell is to be lit."""
        ...

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """Levels of projector and mask, slot by slot."""
        ...


@dataclass(frozen=True, eq=False)
class BlockProgram:
    """``sum_d camera_d projector_d^T``, exactly: D pairs of given levels, no codes (footnote 4)."""

    camera: Floats
    projector: Floats
    coded: bool = False
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """The D pairs themselves; `bits` is not used."""
        return self.projector, self.camera


@dataclass(frozen=True, eq=False)
class CodedProgram:
    """Mask = the code of each cell's partner (Pi = p there, p^2 elsewhere), or its complement
    (0 there, p (1 - p) elsewhere). Cells without a partner stay closed (eq. 8, section 5)."""

    partner: Indices | tuple[int, int] | None
    complement: bool
    p: float = 0.5
    coded: bool = True

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """K pairs."""
        partner = extend_partners(self.partner, lattice)
        mask = bits[:, partner] != self.complement
        return bits, mask & (partner >= 0)


@dataclass(frozen=True, eq=False)
class _Around:
    """Another program, with one panel changed."""

    program: Program

    @property
    def coded(self) -> bool:
        """The same as of the program."""
        return self.program.coded

    @property
    def p(self) -> float:
        """The same as of the program."""
        return self.program.p


@dataclass(frozen=True, eq=False)
class IlluminatedProgram(_Around):
    """Another program with the projector's levels times `light` (N,), 0..1."""

    light: Floats

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """As many pairs as the program has."""
        primal, dual = self.program.pairs(bits, lattice)
        return primal * extend_values(self.light, lattice), dual


@dataclass(frozen=True, eq=False)
class GainProgram(_Around):
    """Another program with the mask's levels times `gain` (N,), 0..1."""

    gain: Floats

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """As many pairs as the program has."""
        primal, dual = self.program.pairs(bits, lattice)
        return primal, dual * extend_values(self.gain, lattice)


def find_inner_program(program: Program) -> Program:
    """The program inside illuminations and gains."""
    while isinstance(program, IlluminatedProgram | GainProgram):
        program = program.program
    return program


@dataclass(frozen=True, eq=False)
class FloodlitProgram:
    """The codes alone through an open mask, for photos that are masked in software."""

    coded: bool = True
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """K pairs."""
        return bits, np.ones_like(bits)


@dataclass(frozen=True, eq=False)
class SignedProgram:
    """One half of ``sum_w weight_w Match(partner_w)`` by +-1 codes h: mask = the same sum over h
    (eq. 9), its positive part under i = (1 + h)/2 and its negative part under (1 - h)/2, or the
    other way around for the half that is subtracted."""

    taps: tuple[tuple[float, Indices | tuple[int, int] | None], ...]
    positive: bool
    coded: bool = True
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """2 K pairs; mask levels are scaled so that the largest is 1."""
        h = np.where(bits, 1.0, -1.0)
        mask = np.zeros_like(h)
        for weight, partner in self.taps:
            where = extend_partners(partner, lattice)
            mask += weight * np.where(where >= 0, h[:, where], 0.0)
        return _halves(bits, mask, self.positive)


@dataclass(frozen=True, eq=False)
class ConvolvedProgram:
    """`SignedProgram` with a tap for every shift: taps[w] pairs each cell n with n - w, w counted
    from the centre of `taps` (odd sides). Its sums are made by FFT."""

    taps: Floats
    positive: bool
    coded: bool = True
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """2 K pairs; mask levels are scaled so that the largest is 1."""
        h = np.where(bits, 1.0, -1.0)
        return _halves(bits, filter_images(h, self.taps, lattice.shape), self.positive)


@dataclass(frozen=True, eq=False)
class SignedMatrixProgram:
    """One half of any matrix A by +-1 codes: mask = A h (eq. 9), in two halves as `SignedProgram`.

    The light of cells that share a column is mixed up. For direct light, which is mostly the
    strongest, this is corrected: a multiple of a cell's own code in its mask makes the diagonal
    exact. The entries of cells that share its column pay for it, with K codes one in K.

    `partners` are matched cells (N,) that are known to be in it."""

    matrix: Floats
    positive: bool
    partners: tuple[Indices, ...] = ()
    coded: bool = True
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """2 K pairs. The matrix is between scene cells, so codes beyond the grid do not matter."""
        h = np.where(bits, 1.0, -1.0)
        rows, cols = lattice.grid
        inner = h.reshape(-1, *lattice.shape)[:, :rows, :cols].reshape(len(h), -1)
        mask = inner @ self.matrix.T
        missing = self.matrix.diagonal() - np.mean(mask * inner, axis=0)
        mask += missing * inner
        return _halves(bits, extend_values(mask, lattice), self.positive)


@dataclass(frozen=True, eq=False)
class SignedBlockProgram:
    """One half of ``sum_d camera_d projector_d^T`` with values of both signs, exactly."""

    camera: Floats
    projector: Floats
    positive: bool
    coded: bool = False
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """2 D pairs."""
        scaled = self.projector / np.abs(self.projector).max()
        plus, minus = np.maximum(scaled, 0.0), np.maximum(-scaled, 0.0)
        mask = self.camera / np.abs(self.camera).max()
        return _pair_up(_in_turn(plus, minus), mask, self.positive)


@dataclass(frozen=True, eq=False)
class LongRangeProgram:
    """Mask = the complement of the code, dilated by a radius: exactly 0 within it, p (1 - p)^W
    elsewhere with W = (2 radius + 1)^2 (Table 2, row 3, in one photo); some more cells are closed
    so that all light is counted evenly (`pdcd.codes.far`)."""

    radius: int
    grey: bool = False
    """Whether the mask may have grey levels."""
    coded: bool = True

    @property
    def p(self) -> float:
        """``1 / (W + 1)``, which makes the weight ``p (1 - p)^W`` largest."""
        return 1.0 / ((2 * self.radius + 1) ** 2 + 1)

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """K pairs."""
        side = 2 * self.radius + 1
        around = np.ones((side, side), dtype=np.uint8)
        lit = bits.reshape(-1, *lattice.shape).astype(np.uint8)
        near = np.stack([cv2.dilate(one, around) for one in lit]).astype(np.bool_)
        seen = ~near.reshape(len(bits), -1)
        return bits, make_long_range_masks(bits, seen, lattice.shape, self.radius, grey=self.grey)


def extend_partners(partner: Indices | tuple[int, int] | None, lattice: Lattice) -> Indices:
    """Partners of all code cells, (L,): of a warp (N,), a shift, or (None) the cells themselves.

    The lattice of quarter windows has one row and column more than the grid; these continue a warp
    from the last row and column of the grid.
    """
    shape = lattice.shape
    if partner is None:
        return np.arange(lattice.lattice_cells)
    if isinstance(partner, tuple):
        return shift_cells(shape, partner)
    inner, down, right = lattice.continued
    target, cols = partner[inner], lattice.grid[1]
    tr, tc = target // cols + down, target % cols + right
    inside = (target >= 0) & (tr < shape[0]) & (tc < shape[1])
    return np.where(inside, tr * shape[1] + tc, -1)


def extend_values(values: Floats, lattice: Lattice) -> Floats:
    """Values over the grid (..., N) -> over the lattice (..., L), continued at the far edges."""
    return values[..., lattice.continued[0]]


def _halves(bits: Bools, mask: Floats, positive: bool) -> LevelPairs:
    """Pairs (i+, m+), (i-, m-), or (i+, m-), (i-, m+) for the half that is subtracted; `mask` is
    overwritten."""
    largest = max(mask.max(), -mask.min())
    if largest > 0.0:
        mask /= largest
    return _pair_up(_in_turn(bits, ~bits), mask, positive)


def _pair_up(lights: Levels, mask: Floats, positive: bool) -> LevelPairs:
    """Both pairs of a code are adjacent, so that the first few codes are like all of them."""
    masks = np.empty((2 * len(mask), mask.shape[1]))
    signed = mask if positive else -mask
    np.maximum(signed, 0.0, out=masks[0::2])
    np.negative(signed, out=signed)
    np.maximum(signed, 0.0, out=masks[1::2])
    return lights, masks


def _in_turn(first: _L, second: _L) -> _L:
    """Rows of two arrays (K, N), alternating, (2 K, N)."""
    return np.stack([first, second], axis=1).reshape(-1, first.shape[1])
