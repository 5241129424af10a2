"""Hard scenes through the whole chain: metering, RAW file, decoding, combination.

The mock camera is free of noise here, but rounds to whole DN and has a white level like any other.
What it cannot know is bounded by half a DN of every photo, taken to the units of the answer.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pdcd.bench.tables import CameraConfig, SceneConfig
from pdcd.pictures.darkroom import Darkroom
from pdcd.recipes.recipe import Extremes
from pdcd.runs.record import Manifest
from tests import bench_rig
from tests.hard_cases.case import Case, Floats, Outcome
from tests.hard_cases.differences import caustic, faint_direct
from tests.taken import take

GRID = bench_rig.GRID
ODD_GRIDS = ((1, 1), (1, 7), (11, 1), (5, 13))
APART = ODD_GRIDS[1:]
"""Grids whose borders the panels' pixels draw apart."""
_BORDERS = 0.002


class Captured:
    """Answer of one capture, its standard deviation, and what half a DN of each photo means."""

    def __init__(
        self, transport: Floats, grid: tuple[int, int], camera: CameraConfig, **fields: Any
    ):
        with tempfile.TemporaryDirectory(prefix="pdcd-hard-") as folder:
            path = Path(folder) / "hard.npz"
            np.savez(path, transport=transport, grid=np.array(grid))
            scene = SceneConfig(kind="matrix", path=str(path))
            made = take(bench_rig.config(Path(folder), scene=scene, camera=camera), **fields)
            self.manifest: Manifest = made.manifest
            decoded = Darkroom(made.folder, self.manifest.run).decoded()
        answer = decoded.answer
        self.image: Floats = answer.image[..., 1].reshape(-1)
        self.sigma: Floats = np.asarray(answer.sigma[..., 1], np.float64).reshape(-1)
        self.saturated = sum(int(shot.saturated.sum()) for shot in decoded.shots.values())
        photos = {photo.name: photo for photo in decoded.recipe.photos}
        assert not isinstance(decoded.recipe.answer, Extremes)
        self.half_dn = sum(
            0.5 * abs(factor) * self._unit(shot) / self.manifest.realised[name]["weight_s"]
            for factor, name in decoded.recipe.answer
            for _, shot in photos[name].shots
        )

    def _unit(self, name: str) -> float:
        """Scene units times seconds of one DN of green."""
        record = self.manifest.run
        shot = next(shot for shot in record.shots if shot.name == name)
        gain = record.profile.row(shot.iso).gain_e_per_dn
        return gain * shot.f_number**2 / record.responsivity_e[1]


def _ideal() -> CameraConfig:
    return CameraConfig(noise="none")


def direct_light(transport: Floats) -> Outcome:
    """Direct light by white less indirect; sixteen codes separate twelve cells exactly."""
    got = Captured(transport, GRID, _ideal(), goal="direct", codes=16)
    assert got.saturated == 0
    return Outcome(float(np.abs(got.image - np.diag(transport)).max() / got.half_dn))


def all_black() -> Outcome:
    """A scene that returns nothing, of every goal: exactly nothing, with a finite sigma."""
    worst = 0.0
    for goal in ("white", "indirect", "direct", "diagonal"):
        got = Captured(np.zeros((12, 12)), GRID, _ideal(), goal=goal, codes=8)
        assert np.isfinite(got.sigma).all() and got.saturated == 0
        assert got.manifest.summary["rms_error_quads"] is None
        worst = max(worst, float(np.abs(got.image).max()))
    return Outcome(worst)


def all_saturated() -> Outcome:
    """A camera wide open: every pixel of every goal says that it knows nothing.

    The error is the share of pixels with a finite sigma or a value that is no number.
    """
    camera = CameraConfig(noise="none", f_number=1.0)
    claims = []
    for goal in ("white", "indirect", "direct", "diagonal"):
        got = Captured(bench_rig.transport() * 1e3, GRID, camera, goal=goal, codes=8)
        claims.append(np.mean(np.isfinite(got.sigma) | ~np.isfinite(got.image)))
    return Outcome(float(max(claims)))


def odd_grid(grid: tuple[int, int]) -> Outcome:
    """Light of all goals with more codes than cells, against the matrix itself. Where panels draw
    borders of cells apart, or a pilot looks for paths, a five-hundredth of white is left."""
    transport = bench_rig.transport(grid)
    direct = np.diag(transport)
    want = {
        "white": transport.sum(axis=1),
        "indirect": transport.sum(axis=1) - direct,
        "direct": direct,
        "diagonal": direct,
    }
    errors = []
    for goal, truth in want.items():
        got = Captured(transport, grid, _ideal(), goal=goal, codes=128, window="whole")
        allowed = got.half_dn + (_BORDERS * float(want["white"].max()) if grid in APART else 0.0)
        errors.append(float(np.abs(got.image - truth).max() / allowed))
    return Outcome(max(errors))


def _case(name: str, reference: str, run: Callable[[], Outcome]) -> Case:
    return Case(name, "of half a DN of each photo", reference, 1.0, run)


CASES = (
    _case(
        "capture: direct light 1 % of the indirect",
        "the scene's own diagonal",
        lambda: direct_light(faint_direct(100.0)),
    ),
    _case(
        "capture: direct light under a caustic 100 000 times as bright",
        "the scene's own diagonal",
        lambda: direct_light(1e-4 * caustic(1e5)),
    ),
    Case("capture: all pixels black", "scene units", "nothing", 0.0, all_black),
    Case(
        "capture: all pixels saturated",
        "share of pixels that claim to know",
        "no pixel can know",
        0.0,
        all_saturated,
    ),
    *(
        _case(
            f"capture: all goals on {grid[1]}x{grid[0]} cells",
            "dense transport matrix",
            partial(odd_grid, grid),
        )
        for grid in ODD_GRIDS
    ),
)
