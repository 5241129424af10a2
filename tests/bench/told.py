"""Smooth light as the parts of a photo tell it, over what its image alone tells, on many scenes.

    python -m tests.bench.told

Scenes of 24 x 32 cells: eight laws by which light falls off, four kinds of surface, all of the
field or a disk in it; each with two seeds and with and without noise of 1 % in each part. Indirect
light in 6 parts of 20 codes, and far light of a radius of 2 in 4 parts of 31.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pdcd.codes.far import make_long_range_codes
from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.pictures.smooth import CodedImage, compute_smooth_correction, estimate_smooth_shares
from pdcd.recipes.parts import derive_part_seed, randomise_signs
from pdcd.recipes.programs import LongRangeProgram

GRID = (24, 32)
N = GRID[0] * GRID[1]
RADIUS, SEEDS, NOISE = 2, (0, 1), (0.0, 0.01)
PARTS = {0: (6, 20), RADIUS: (4, 31)}
"""Radius, 0 for indirect light, -> parts and codes of each."""
LEAST = 1e-5
"""Errors below count as this: some photos are exact."""
ROW, COL = np.divmod(np.arange(N), GRID[1])
APART = np.hypot(ROW[:, None] - ROW, COL[:, None] - COL)
SQUARE = np.maximum(abs(ROW[:, None] - ROW), abs(COL[:, None] - COL))

Floats = NDArray[np.float64]
Codes = tuple[Floats, Floats]
"""Levels of projector and mask, (K, N) each."""


def scenes() -> Iterator[tuple[str, Floats]]:
    """Names and transport matrices (N, N) without direct light."""
    rng = np.random.default_rng(0)
    sides = (COL[:, None] < GRID[1] / 2) != (GRID[1] / 2 > COL)
    laws = {
        "even": np.ones((N, N)),
        "near": 1.0 / (1.0 + (APART / 2.0) ** 2),
        "falls over 3 cells": np.exp(-APART / 3.0),
        "falls over 10 cells": np.exp(-APART / 10.0),
        "Gaussian of 5 cells": np.exp(-((APART / 5.0) ** 2) / 2.0),
        "inverse": 1.0 / (1.0 + APART),
        "two walls": sides / (1.0 + (APART / 10.0) ** 2),
        "mirror": np.eye(N)[::-1] + 0.02 / N,
    }
    surfaces = {
        "flat": np.ones(N),
        "smooth": 1.0 + 0.7 * np.sin(COL / 7.0) * np.cos(ROW / 5.0),
        "patchy": np.kron(rng.uniform(0.2, 1.0, (6, 8)), np.ones((4, 4))).ravel(),
        "textured": np.exp(0.7 * rng.standard_normal(N)),
    }
    middle = np.hypot(ROW - 11.5, COL - 15.5)
    regions = {"whole field": np.ones(N), "disk": (middle < 10.0).astype(np.float64)}
    for law, surface, region in itertools.product(laws, surfaces, regions):
        albedo = surfaces[surface] * regions[region]
        yield f"{law}, {surface}, {region}", laws[law] * albedo[:, None] * albedo


def codes(radius: int, seed: int) -> list[Codes]:
    """Those of each part."""
    parts, count = PARTS[radius]
    found = []
    for part in range(1, parts + 1):
        own = derive_part_seed(seed, parts, part)
        if radius:
            lit = make_long_range_codes(
                GRID, count, LongRangeProgram(radius).p, np.random.default_rng(own), grey=True
            )
            light, mask = LongRangeProgram(radius, True).pairs(lit, Lattice(GRID, "whole"))
        else:
            bits = make_codes("hadamard", GRID, count, dual="complement", seed=own).primal
            light = randomise_signs(bits, own)
            mask = ~light
        found.append((light.astype(np.float64), mask.astype(np.float64)))
    return found


def coded(some: Codes, image: Floats, wanted: Floats, radius: int) -> CodedImage:
    """A photo by some codes; `image` is its light before it is divided."""
    light, mask = some
    weight = np.sum((mask.T @ light) * wanted, axis=1) / wanted.sum(axis=1)
    if not radius:
        weight = np.full(N, weight.mean())
    return CodedImage(mask, light, weight, image / weight)


def errors(transport: Floats, some: list[Codes], radius: int, noise: float) -> list[float]:
    """RMS error over that of the truth: as taken, as the image tells, as the parts tell."""
    wanted = (radius < SQUARE).astype(np.float64)
    light, rng = transport * wanted, np.random.default_rng(1)
    truth = light.sum(axis=1)
    photos = []
    for lit, mask in some:
        image = np.sum((mask.T @ lit) * light, axis=1)
        photos.append(image * (1.0 + noise * rng.standard_normal(N)))
    parts = [coded(one, image, wanted, radius) for one, image in zip(some, photos, strict=True)]
    together = tuple(np.concatenate(side) for side in zip(*some, strict=True))
    whole = coded((together[0], together[1]), np.sum(photos, axis=0), wanted, radius)
    shares = estimate_smooth_shares(whole, parts, GRID, radius)
    found = [whole.image]
    for told in (None, shares):
        more = compute_smooth_correction(
            whole.left, whole.right, whole.weight, whole.image, GRID, beyond=radius, shares=told
        )
        found.append(whole.image + more)
    return [float(np.sqrt(np.mean((one - truth) ** 2) / np.mean(truth**2))) for one in found]


def main() -> None:
    """Print what is gained, and where least."""
    for radius in PARTS:
        sets = [codes(radius, seed) for seed in SEEDS]
        rows = []
        for name, transport in scenes():
            for some, noise in itertools.product(sets, NOISE):
                taken, alone, told = errors(transport, some, radius, noise)
                rows.append(
                    (
                        max(told, LEAST) / max(alone, LEAST),
                        f"{name}, noise {noise:g}",
                        taken,
                        alone,
                        told,
                    )
                )
        gains = np.array([row[0] for row in rows])
        mean = np.exp(np.log(gains).mean())
        sys.stdout.write(
            f"radius {radius}: {len(rows)} photos, error {mean:.3f} of that by "
            f"the image alone (geometric mean), worse by more than 3 % in "
            f"{(gains > 1.03).sum()}; least gains:\n"
        )
        for gain, name, *three in sorted(rows, reverse=True)[:3]:
            figures = ", ".join(f"{100.0 * one:.3g} %" for one in three)
            sys.stdout.write(f"    {gain:.3f}  {name}: {figures}\n")


if __name__ == "__main__":
    main()
