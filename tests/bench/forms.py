"""One effect in several forms: what a cheaper model of the transport costs and what it loses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.virtual.scene.effects import DenseEffect, Effect, LowRankEffect, SparseEffect
from pdcd.virtual.scene.kernel import KernelEffect
from pdcd.virtual.scene.matrix import load_matrix
from pdcd.virtual.scene.presets import PRESETS
from tests.bench.measure import peak_mib, timed
from tests.places import ROOT

Floats = NDArray[np.float64]

GRID = (48, 64)
COUNT = 128
"""Codes of the exposure that every form is asked for."""

SUBJECTS: dict[str, tuple[str, str]] = {
    "corner": ("corner_32x24", "indirect"),
    "book": ("open-book", "between the pages"),
    "wax": ("wax-disk", "deep inside"),
    "spots": ("disco-ball", "spots"),
    "veil": ("milky-bottle", "veil"),
}
"""Name -> preset or matrix file, and the effect of it."""

TOLERANCES = (1e-2, 1e-4, 1e-8)
"""Of low rank: share of the largest singular value. Of sparse and stencil: of the largest entry."""

SKETCH = 512
"""Most terms of a low-rank form. What needs more has no low rank."""
SHARED = 0.25
"""Share of entries up to which cutting small ones off is called sparse."""


@dataclass(frozen=True, eq=False)
class Fourier(KernelEffect):
    """A kernel by the Fourier transform, also where two small products would be cheaper."""

    @cached_property
    def _factors(self) -> tuple[tuple[Floats, Floats], ...]:
        return ()


@dataclass(frozen=True, eq=False)
class Stencil(KernelEffect):
    """A kernel by adding up shifted images, as far as its weights are worth it."""

    def _spread(self, images: Floats) -> Floats:
        turned = np.ascontiguousarray(self.kernel[::-1, ::-1])  # filter2D correlates
        border = cv2.BORDER_CONSTANT
        return np.stack(
            [cv2.filter2D(one, cv2.CV_64F, turned, borderType=border) for one in images]
        )


def measure_form(subject: str) -> list[dict[str, Any]]:
    """Time to probe, bytes kept and RMS error of all forms of one effect, the dense one first.

    The error is that of the photo, relative to the RMS of the photo by the dense form.
    """
    own, grid = _effect(subject)
    codes = make_codes("hadamard", grid, COUNT, dual="complement", seed=1)
    left, right = codes.dual.astype(np.float64), codes.primal.astype(np.float64)
    found: list[dict[str, Any]] = []
    truth: Floats | None = None
    for name, effect, kept in _forms(own):
        time_s, photo = timed(lambda effect=effect: effect.probe(left, right))  # type: ignore[misc]
        truth = photo if truth is None else truth
        wrong = float(np.sqrt(np.mean((photo - truth) ** 2) / np.mean(truth**2)))
        found.append({"form": name, "time_s": time_s, "kept_mib": kept / 2**20, "error": wrong})
    found[0]["peak_mib"] = peak_mib()
    return found


def _effect(subject: str) -> tuple[Effect, tuple[int, int]]:
    scene, name = SUBJECTS[subject]
    if scene in PRESETS:
        effects = PRESETS[scene](GRID, {}).effects
        return next(effect for effect in effects if effect.name == name), GRID
    stored = load_matrix(ROOT / "tests" / "data" / f"{scene}.npz")
    np.fill_diagonal(stored.transport, 0.0)
    return DenseEffect(name, stored.transport), stored.grid


def _forms(own: Effect) -> Iterator[tuple[str, Effect, int]]:
    """Name, effect and bytes of each form of an effect."""
    whole = own.dense()
    yield "dense", DenseEffect(own.name, whole), whole.nbytes
    if not isinstance(own, DenseEffect):
        yield f"its own: {type(own).__name__}", own, _bytes(own)
    yield from _sparse(own.name, whole)
    yield from _low_rank(own.name, whole)
    if isinstance(own, KernelEffect):
        parts = (own.name, own.grid, own.kernel, own.out, own.into)
        yield "Fourier", Fourier(*parts), own.kernel.nbytes
        for tolerance in TOLERANCES[:2]:
            cut = _cut(own.kernel, tolerance)
            size = f"{cut.shape[1]}x{cut.shape[0]}"
            yield (
                f"stencil {size}, {tolerance:.0e}",
                Stencil(*parts[:2], cut, *parts[3:]),
                cut.nbytes,
            )


def _sparse(name: str, whole: Floats) -> Iterator[tuple[str, Effect, int]]:
    """All entries that are not 0, then without small ones, where that leaves few enough."""
    before = -1
    for tolerance in (0.0, *reversed(TOLERANCES)):
        kept = whole > tolerance * whole.max()
        count = int(kept.sum())
        if count <= SHARED * whole.size and count != before:
            matrix = scipy.sparse.csr_array(np.where(kept, whole, 0.0))
            size = matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes
            label = f"sparse, {tolerance:.0e}" if tolerance else "sparse"
            yield label, SparseEffect(name, matrix), size
            before = count


def _low_rank(name: str, whole: Floats) -> Iterator[tuple[str, Effect, int]]:
    """Sums of few products, found in a random sketch of the matrix (Halko et al. 2011)."""
    rng = np.random.default_rng(1)
    columns = min(SKETCH, len(whole))
    basis = np.linalg.qr(whole @ rng.standard_normal((len(whole), columns)))[0]
    basis = np.linalg.qr(whole @ np.linalg.qr(whole.T @ basis)[0])[0]
    left, values, right = np.linalg.svd(basis.T @ whole, full_matrices=False)
    for tolerance in TOLERANCES:
        rank = max(1, int(np.sum(values > tolerance * values[0])))
        if rank == columns < len(whole):
            return
        a, b = basis @ (left[:, :rank] * values[:rank]), right[:rank].T.copy()
        yield f"rank {rank}, {tolerance:.0e}", LowRankEffect(name, a, b), a.nbytes + b.nbytes


def _cut(kernel: Floats, tolerance: float) -> Floats:
    """The middle of a kernel, without margins whose weights are all below the tolerance."""
    big = kernel > tolerance * kernel.max()
    reach = [
        int(np.abs(np.flatnonzero(big.any(axis=1 - a)) - kernel.shape[a] // 2).max())
        for a in (0, 1)
    ]
    middle = [
        slice(size // 2 - r, size // 2 + r + 1) for size, r in zip(kernel.shape, reach, strict=True)
    ]
    return np.ascontiguousarray(kernel[tuple(middle)])


def _bytes(effect: Any) -> int:
    """Bytes of all arrays that an effect keeps, derived ones included once it was used."""
    total = 0
    for value in vars(effect).values():
        for item in value if isinstance(value, tuple) else (value,):
            if scipy.sparse.issparse(item):
                total += item.data.nbytes + item.indices.nbytes + item.indptr.nbytes
            elif isinstance(item, np.ndarray):
                total += item.nbytes
    return total
