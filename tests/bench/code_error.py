"""Error of the indirect image over the number of codes, for every family and scene."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.codes.make import Codes, make_codes
from pdcd.pictures.smooth import compute_colour_correction
from pdcd.probing.realised import Factors
from pdcd.virtual.scene.matrix import load_matrix
from pdcd.virtual.scene.presets import PRESETS
from pdcd.virtual.scene.scene import Scene
from tests.bench import plots
from tests.bench.captures import noisy_errors
from tests.bench.tables import Aim, Section, Table, percent
from tests.places import DATA
from tests.taken import relative_rms

FIRST, BEST = "bernoulli", "hadamard"
FAMILIES = (FIRST, "balanced", BEST)
CORRECTED = "hadamard, corrected"
"""The same codes with what their photo tells of smooth light (`pdcd.pictures.smooth`): the
default."""
COUNTS = (8, 32, 128, 512, 1024)
SEEDS = 5
GRID = (48, 64)
MATRICES = ("corner_32x24", "mirror_32x24")

ROUNDING = 1e-12
"""Errors below this are rounding: the codes are exact, and have no point in the plot."""

DIFFUSE, THROUGH = ("corner_32x24", "open-book"), ("wax-disk", "milky-bottle")
LIMITS = {(128, DIFFUSE): 1 / 10, (128, THROUGH): 1 / 40, (512, DIFFUSE): 1 / 20}
LIMITS |= {(512, THROUGH): 1 / 100}
"""Wanted error of the default codes without noise, over that of as many coins."""

NOISY_SCENES = ("open-book", "mirror_32x24")
NOISY_COUNTS = (8, 32, 128, 512)
NOISY_SEEDS = 2

Errors = dict[tuple[str, int, str], float]
"""(scene, number of codes, family) -> RMS error over the RMS of the true indirect image."""


def run(*, quick: bool, folder: Path) -> Section:
    """Evaluate all scenes, without noise and with it."""
    counts = (8, 128) if quick else COUNTS
    ideal = _ideal_errors(counts, 2 if quick else SEEDS)
    noisy_counts = (8, 128) if quick else NOISY_COUNTS
    noisy = _noisy_errors(noisy_counts, 1 if quick else NOISY_SEEDS)
    _plot(ideal, folder / "code-error.png", "no sensor noise")
    _plot(noisy, folder / "code-error-noise.png", "full sensor noise")
    few, many = min(counts), 128
    better = [s for s in _names(ideal) if ideal[s, few, CORRECTED] <= ideal[s, many, FIRST]]
    gains = [ideal[s, many, FIRST] / ideal[s, many, CORRECTED] for s in _names(ideal)]
    return Section(
        title="Error of the indirect image over the number of codes",
        text=(
            "RMS error of the indirect photo over the RMS of the true indirect image, each photo "
            "scaled by its own least-squares weight, as decoding does it. Whole windows, ideal "
            "panels. Behind each error stands how many times smaller it is than that of as many "
            f"`{FIRST}` codes (independent coins, as in the paper). The default is `{BEST}` codes "
            "with what their photo tells of smooth light taken off, 'corrected'; with noise only "
            f"these are shown. In this run {many} of them are {min(gains):.3g} to {max(gains):.3g} "
            f"times better than {many} `{FIRST}` "
            f"codes, and {few} of them do at least as well as {many} `{FIRST}` ones on "
            f"{len(better)} of {len(gains)} scenes ({', '.join(better) or 'none'}). Single sharp "
            "paths, as mirrors and glitter throw them, are the hard case: two cells with the same "
            "column see each other too strongly. With full sensor noise the error cannot fall "
            "below what photon and read noise of one exposure leave."
        ),
        tables=[
            _table(ideal, f"Without noise, mean over {2 if quick else SEEDS} seeds"),
            _table(noisy, f"Full sensor noise, mean over {1 if quick else NOISY_SEEDS} captures"),
        ],
        aims=_aims(ideal, counts),
        plots=[
            ("code-error.png", "Error against K without noise; exact sets have no point."),
            ("code-error-noise.png", "The same with photon, read and dark noise of the sensor."),
        ],
    )


def load_scenes(grid: tuple[int, int], presets: Iterable[str]) -> Iterator[Scene]:
    """Both path-traced scenes, and presets on these cells."""
    for name in MATRICES:
        stored = load_matrix(DATA / f"{name}.npz")
        yield Scene(name, stored.grid, stored.effects())
    for name in presets:
        yield PRESETS[name](grid, {})


def _ideal_errors(counts: tuple[int, ...], seeds: int) -> Errors:
    errors: dict[tuple[str, int, str], list[float]] = {}
    for grid, group in itertools.groupby(load_scenes(GRID, PRESETS), key=lambda scene: scene.grid):
        known = [(scene, scene.split()[1]) for scene in group]
        for count, family, seed in itertools.product(counts, FAMILIES, range(seeds)):
            codes = make_codes(family, grid, count, dual="complement", seed=seed)
            matrix, scale = _probing(codes)
            for scene, truth in known:
                photo = scene.photo(matrix.left, matrix.right, matrix.coaxial, matrix.open_s)
                found = {family: photo / scale}
                if family == BEST:
                    more = compute_colour_correction(
                        matrix.left, matrix.right, scale, found[BEST], grid
                    )
                    found[CORRECTED] = found[BEST] + more
                for name, image in found.items():
                    error = relative_rms(image, truth)
                    errors.setdefault((scene.name, count, name), []).append(error)
    return {key: float(np.mean(values)) for key, values in errors.items()}


def _probing(codes: Codes) -> tuple[Factors, float]:
    """Matrix that ideal panels give these codes, one second each, and its mean entry off the
    diagonal, which is the least-squares factor to the wanted matrix of ones."""
    left, right = codes.dual.astype(np.float64), codes.primal.astype(np.float64)
    coaxial: NDArray[np.float64] = (left * right).sum(axis=0)
    matrix = Factors(left, right, coaxial, left.sum(axis=0))
    cells = coaxial.size
    return matrix, (matrix.total_s - matrix.trace_s) / (cells * (cells - 1))


def _noisy_errors(counts: tuple[int, ...], seeds: int) -> Errors:
    cases = [*itertools.product(NOISY_SCENES, counts, FAMILIES, range(seeds))]
    found: dict[tuple[str, int, str], list[float]] = {}
    for (scene, count, family, _), error in zip(cases, noisy_errors(cases), strict=True):
        found.setdefault((scene, count, CORRECTED if family == BEST else family), []).append(error)
    return {key: float(np.mean(errors)) for key, errors in found.items()}


def _aims(errors: Errors, counts: tuple[int, ...]) -> list[Aim]:
    """The worst scene of each kind against the wanted errors."""
    aims = []
    for (count, scenes), limit in LIMITS.items():
        if count in counts:
            worst = max(errors[s, count, CORRECTED] / errors[s, count, FIRST] for s in scenes)
            name = f"error of {count} default codes over coins, {' and '.join(scenes)}"
            aims.append(Aim(name, "", worst, limit))
    smooth = (*DIFFUSE, *THROUGH)
    worst = max(errors[s, 8, CORRECTED] / errors[s, 128, FIRST] for s in smooth)
    return [*aims, Aim("error of 8 default codes over 128 coins, smooth scenes", "", worst, 1.0)]


def _names(errors: Errors) -> list[str]:
    """All scenes, in order."""
    return list(dict.fromkeys(key[0] for key in errors))


def _table(errors: Errors, title: str) -> Table:
    families = tuple(dict.fromkeys(key[2] for key in errors))
    table = Table(title, ("scene", "K", *families))
    counts = dict.fromkeys(key[1] for key in errors)
    for scene, count in itertools.product(_names(errors), counts):
        base = errors[scene, count, FIRST]
        cells = [percent(base)]
        for family in families[1:]:
            error = errors[scene, count, family]
            exact = error < ROUNDING
            cells.append("exact" if exact else f"{percent(error)} ({base / error:.3g}x)")
        table.add(scene, str(count), *cells)
    return table


def _plot(errors: Errors, path: Path, what: str) -> None:
    scenes = _names(errors)
    figure, axes = plots.scene_panels(len(scenes))
    for scene, one in zip(scenes, axes, strict=False):
        for index, family in enumerate(dict.fromkeys(key[2] for key in errors)):
            counts = [key[1] for key in errors if key[0] == scene and key[2] == family]
            values = np.array([errors[scene, count, family] for count in counts])
            shares = np.where(values < ROUNDING, np.nan, 100.0 * values)
            one.plot(counts, shares, **plots.style(index, ms=5, label=family))
        plots.finish(one, scene, "number of codes K", "RMS error in %")
    figure.suptitle(what, fontsize=11)
    plots.legend(*plots.find_room(axes, len(scenes)))
    plots.save(figure, path)
