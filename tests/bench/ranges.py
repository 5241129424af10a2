"""Error of light from beyond a radius, and from within it, over the number of codes."""

from __future__ import annotations

import itertools
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.codes.far import make_long_range_codes
from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.pictures.smooth import compute_colour_correction
from pdcd.probing.wanted import NearPart
from pdcd.recipes.programs import LongRangeProgram
from pdcd.virtual.scene.scene import Scene
from tests.bench import plots
from tests.bench.code_error import load_scenes
from tests.bench.tables import Section, Table, percent
from tests.taken import relative_rms

GRID = (24, 32)
RADIUS = 2
COUNTS = (128, 512)
SEEDS = 5
SCENES = ("open-book", "wax-disk", "milky-bottle", "disco-ball")
GOALS = ("long-range", "short-range")

SHOWN, SHOWN_SEED = 6, 0
"""Codes of each that are drawn, and their seed."""

Floats = NDArray[np.float64]
Errors = dict[tuple[str, int, str, str], float]
"""(scene, number of codes, goal, a key of `HOW`) -> RMS error over the true RMS."""
HOW = ("balanced", "black and white", "grey masks")
"""Balanced codes, each closed around lit cells and nowhere else; masks of black and white; and of
grey levels."""


def run(*, quick: bool, folder: Path) -> Section:
    """Evaluate all scenes, without noise."""
    draw(folder / "far-codes.png")
    errors = _errors(COUNTS[:1] if quick else COUNTS, 1 if quick else SEEDS)
    ways = [f"{goal}, {how}" for goal in GOALS for how in HOW]
    heads = ("scene", "K", *ways)
    table = Table(f"Radius {RADIUS}, without noise, mean over {1 if quick else SEEDS} seeds", heads)
    for scene, count in dict.fromkeys(key[:2] for key in errors):
        cells = [errors[scene, count, g, h] for g in GOALS for h in HOW]
        table.add(scene, str(count), *map(percent, cells))
    return Section(
        title="Long- and short-range light over the number of codes",
        text=(
            "RMS error of the pictures of the goals long-range and short-range over the RMS of the "
            "true ones, 24 x 32 cells, whole windows, ideal panels. Balanced: cells lit as often "
            "as brings most light, each for itself, and the mask closed around them alone. Black "
            "and white: dealt out evenly, half as often, and the mask closed at more cells so "
            "that far light is counted alike. Grey masks: lit less often, and the mask at the "
            "levels that count far light most alike, the default where the mask's levels are "
            "known. But for the balanced ones less what the codes get wrong of smooth light, by a "
            "model that the photo gives. Short-range light is the difference of the indirect "
            "photo, which is corrected in all, and the far one."
        ),
        tables=[table],
        aims=[],
        plots=[("far-codes.png", "Codes for far light: light in orange, the open mask in blue.")],
    )


def draw(path: Path) -> None:
    """Some codes of each way, a row each: light in orange, the mask in blue."""
    rows = {}
    ways = (
        ("128 codes, masks of black and white", 128, HOW[1]),
        ("128 codes, grey masks", 128, HOW[2]),
        ("512 codes, grey masks", 512, HOW[2]),
    )
    for title, count, how in ways:
        light, mask = _codes(GRID, count, SHOWN_SEED)[how]
        # Light in orange, the mask in blue: told apart without red and green.
        shown = light[..., None] * (1.0, 0.6, 0.0) + mask[..., None] * (0.0, 0.45, 0.9)
        rows[title] = np.clip(shown, 0.0, 1.0).reshape(count, *GRID, 3)[:SHOWN]
    figure, axes = plots.panels(SHOWN, len(rows), scale=0.35)
    for axis, image in zip(axes, np.concatenate([*rows.values()]), strict=True):
        axis.imshow(image, interpolation="nearest")
        axis.set_axis_off()
    for axis, title in zip(axes[::SHOWN], rows, strict=True):
        axis.set_title(title, fontsize=12, loc="left")
    plots.save(figure, path)


def _errors(counts: tuple[int, ...], seeds: int) -> Errors:
    errors: dict[tuple[str, int, str, str], list[float]] = {}
    for scene in load_scenes(GRID, SCENES):
        transport = scene.dense()
        near = NearPart(scene.grid, RADIUS).rows(0, scene.cells)
        own = np.eye(scene.cells)
        truth = {
            "long-range": np.einsum("nm,cnm->nc", 1.0 - near, transport),
            "short-range": np.einsum("nm,cnm->nc", near - own, transport),
        }
        for count, seed in itertools.product(counts, range(seeds)):
            indirect = _indirect(scene, transport, count, seed)
            for how, far in _far(scene, transport, count, seed).items():
                found = {"long-range": far, "short-range": indirect - far}
                for goal, image in found.items():
                    error = relative_rms(image, truth[goal])
                    errors.setdefault((scene.name, count, goal, how), []).append(error)
    return {key: float(np.mean(values)) for key, values in errors.items()}


def _indirect(scene: Scene, transport: Floats, count: int, seed: int) -> Floats:
    """The indirect picture, corrected, (N, C)."""
    codes = make_codes("hadamard", scene.grid, count, dual="complement", seed=seed)
    left, right = codes.dual.astype(np.float64), codes.primal.astype(np.float64)
    weight = _mean(left, right)
    image = np.einsum("nm,cnm->nc", left.T @ right, transport) / weight
    return np.asarray(image + compute_colour_correction(left, right, weight, image, scene.grid))


def _mean(left: Floats, right: Floats) -> float:
    """Mean entry of ``left.T @ right`` off its diagonal."""
    cells = left.shape[1]
    every = float(left.sum(axis=1) @ right.sum(axis=1)) - float(np.sum(left * right))
    return float(every / (cells * (cells - 1)))


def _far(scene: Scene, transport: Floats, count: int, seed: int) -> dict[str, Floats]:
    """The picture of far light in every way of `HOW`, (N, C)."""
    found = {}
    for how, (light, mask) in _codes(scene.grid, count, seed).items():
        image, weight = _pictured(mask, light, scene, transport)
        more = compute_colour_correction(mask, light, weight, image, scene.grid, beyond=RADIUS)
        found[how] = image if how == HOW[0] else np.asarray(image + more)
    return found


def _codes(grid: tuple[int, int], count: int, seed: int) -> dict[str, tuple[Floats, Floats]]:
    """Levels of projector and mask, (K, N) each, in every way of `HOW`."""
    best = LongRangeProgram(RADIUS).p
    share = max(1, round(best * count)) / count
    old = make_codes("balanced", grid, count, dual="same", p=share, seed=seed).primal
    size = 2 * RADIUS + 1
    kernel, images = np.ones((size, size)), old.reshape(-1, *grid).astype(np.float64)
    near = np.stack([cv2.dilate(image, kernel) for image in images]).reshape(old.shape)
    dealt = {
        how: make_long_range_codes(grid, count, best, np.random.default_rng(seed), grey=grey)
        for how, grey in ((HOW[1], False), (HOW[2], True))
    }
    found = {HOW[0]: (old.astype(np.float64), np.asarray(1.0 - near, np.float64))}
    for how, light in dealt.items():
        both = LongRangeProgram(RADIUS, how != HOW[1]).pairs(light, Lattice(grid, "whole"))
        found[how] = (both[0].astype(np.float64), both[1].astype(np.float64))
    return found


def _pictured(
    left: Floats, right: Floats, scene: Scene, transport: Floats
) -> tuple[Floats, Floats]:
    """The picture (N, C), each cell over its own weight (N,)."""
    realised = left.T @ right
    wanted = 1.0 - NearPart(scene.grid, RADIUS).rows(0, scene.cells)
    weight = np.sum(realised * wanted, axis=1) / wanted.sum(axis=1)
    return np.einsum("nm,cnm->nc", realised, transport) / weight[:, None], weight
