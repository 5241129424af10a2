"""Small differences of large photos: faint direct light, caustics, weak contrast, few lit codes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from pdcd.codes.make import make_codes
from pdcd.panels.patterns import Patterns
from pdcd.panels.schedule import build_frames
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.picture import Picture
from pdcd.probing.panel import PanelOptics
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap
from tests import bench_rig
from tests.combined import combine_shots
from tests.hard_cases.case import Case, Floats, Outcome, worst
from tests.hard_cases.exposures import exact, log_of, photo, realised

GRID = bench_rig.GRID
CELLS = GRID[0] * GRID[1]
NS = Fraction(1, 10**9)


def faint_direct(ratio: float) -> Floats:
    """A transport whose direct light is the indirect light over `ratio`, cell by cell."""
    indirect = bench_rig.transport()
    np.fill_diagonal(indirect, 0.0)
    return np.asarray(indirect + np.diag(indirect.sum(axis=1) / ratio))


def caustic(peak: float) -> Floats:
    """A transport with one path `peak` times as strong as the direct light of its cell."""
    transport = bench_rig.transport()
    transport[5, 2] = peak * transport[5, 5]
    return transport


def pictures(
    recipe: Recipe,
    transport: Floats,
    patterns: tuple[Patterns, Patterns],
    panels: tuple[PanelOptics, PanelOptics] = (PanelOptics(), PanelOptics()),
    *,
    ambient: Fraction = Fraction(0),
    dtype: type[np.floating] = np.float64,
) -> dict[str, Picture]:
    """Pictures from photos whose light is exact but for the last rounding to `dtype`."""
    leaks = Fraction(panels[0].leak), Fraction(panels[1].leak)
    shots = {}
    for shot in recipe.shots:
        frames = build_frames(
            None if shot.white else patterns,
            GRID,
            window="whole",
            schedule="full",
            passes=16 if shot.white else 1,
            primal_black=shot.primal_black,
            dual_black=shot.dual_black,
        )
        log = log_of(frames)
        whole = exact(frames, log)
        seen = photo(whole.matrix(*leaks), transport)
        opened = whole.open_time(leaks[1])
        light_s = [NS * (s + ambient * o) for s, o in zip(seen, opened, strict=True)]
        image = np.array([float(x) for x in light_s]).astype(dtype).astype(np.float64)
        image = image.reshape(*GRID, 1).repeat(3, axis=2)
        shots[shot.name] = ComputedShot(
            image, np.ones_like(image), np.zeros(GRID, bool), realised(frames, log, *panels), {}
        )
    return combine_shots(recipe, shots, CellMap.block(GRID, GRID))


def direct_of(transport: Floats) -> Outcome:
    """Direct light as white less indirect, each cell relative to its own direct light.

    Sixteen Hadamard codes separate twelve cells exactly: all error is arithmetic.
    """
    codes = bench_rig.pairs(make_codes("hadamard", GRID, 16, dual="complement", seed=2))
    recipe = make_recipe(Target(Goal(name="direct"), GRID), CaptureScheme())
    want = [Fraction(d) for d in np.diag(transport).tolist()]
    errors = []
    for dtype in (np.float64, np.float32):
        image = pictures(recipe, transport, codes, dtype=dtype)["direct"].image[..., 0].ravel()
        errors.append(max(worst(image[n : n + 1], [d], d) for n, d in enumerate(want)))
    return Outcome(*errors)


def weak_contrast() -> Outcome:
    """Indirect light with both panels at 50:1, under ambient light, by four photos (L3)."""
    codes = bench_rig.pairs(make_codes("hadamard", GRID, 16, dual="complement", seed=2))
    transport = bench_rig.transport()
    panels = PanelOptics(leak=1 / 50), PanelOptics(leak=1 / 50)
    indirect = transport - np.diag(np.diag(transport))
    want = [sum(map(Fraction, row), Fraction()) for row in indirect.tolist()]
    errors = []
    for level in ("both", "none"):
        recipe = make_recipe(
            Target(Goal(name="indirect"), GRID), CaptureScheme(black_level=level, white=False)
        )
        image = pictures(recipe, transport, codes, panels, ambient=Fraction(3, 10))["indirect"]
        errors.append(worst(image.image[..., 0], want, min(want)))
    return Outcome(*errors)


def rarely_lit() -> Outcome:
    """Direct light and a sixteenth of the indirect: each cell lit in one code of sixteen.

    What codes miss is no matter of arithmetic, so the reference is ``(Pi_hat o T) 1 / weight``
    with the realised matrix in fractions, and the weight that direct light has in it.
    """
    p = Fraction(1, 16)
    codes = bench_rig.pairs(make_codes("balanced", GRID, 16, dual="same", p=float(p), seed=3))
    transport = bench_rig.transport()
    recipe = make_recipe(Target(Goal(name="fraction", p=float(p)), GRID), CaptureScheme())
    frames = build_frames(codes, GRID, window="whole", schedule="full", passes=1)
    matrix = exact(frames, log_of(frames)).matrix(Fraction(0), Fraction(0))
    weight = sum((matrix[n][n] for n in range(CELLS)), Fraction()) / CELLS
    want = [light / weight for light in photo(matrix, transport)]
    errors = []
    for dtype in (np.float64, np.float32):
        got = pictures(recipe, transport, codes, dtype=dtype)["fraction"].image[..., 0]
        errors.append(worst(got, want, min(want)))
    return Outcome(*errors)


CASES = (
    Case(
        "direct light 1 % of the indirect",
        "of each cell's direct light",
        "the scene's own diagonal",
        2e-13,
        lambda: direct_of(faint_direct(100.0)),
        "photos kept in float32",
    ),
    Case(
        "direct light under a caustic 100 000 times as bright",
        "of each cell's direct light",
        "the scene's own diagonal",
        2e-10,
        lambda: direct_of(caustic(1e5)),
        "photos kept in float32",
    ),
    Case(
        "both panels at 50:1, ambient light",
        "of the darkest cell",
        "the scene's indirect light, in fractions",
        1e-14,
        weak_contrast,
        "no black levels taken off",
    ),
    Case(
        "p = 1/16",
        "of the darkest cell",
        "realised matrix and weight in fractions",
        2e-14,
        rarely_lit,
        "photos kept in float32",
    ),
)
