"""The algorithms of Figure 7, rows A1 to A4: path isolation in both forms, and optical probing."""

from __future__ import annotations

import csv
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig
from pdcd.capture.engine import Engine
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.planning.make import make_plan
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from tests import bench_rig
from tests.sampled import sampled
from tests.taken import Taken, request_of, take

pytestmark = pytest.mark.whole

GRID = bench_rig.GRID
N = GRID[0] * GRID[1]
T = bench_rig.transport()
RNG = np.random.default_rng(21)
SIGNED = np.round(RNG.normal(size=(N, N)), 3) * (RNG.random((N, N)) < 0.3)
WEIGHTS = np.round(RNG.random((N, N)), 3)
NEXT = np.array([[n % GRID[1] > 0 and (n == m) - 1.0 * (m == n - 1) for m in range(N)]
                 for n in range(N)])  # fmt: skip

GOALS: dict[str, tuple[dict[str, Any], Any]] = {
    "identity": ({"goal": "diagonal"}, np.eye(N)),
    "indirect": ({"goal": "indirect"}, 1.0 - np.eye(N)),
    "weights": ({"goal": "relit", "matrix": WEIGHTS.tolist()}, WEIGHTS),
    "signed": ({"goal": "relit", "matrix": SIGNED.tolist()}, SIGNED),
    "difference": ({"goal": "descattered", "shift": [0, -1]}, NEXT),
}


def run(folder: Path, config: Config | None = None, **fields: Any) -> Taken:
    """A capture without a white shot."""
    folder.mkdir(exist_ok=True)
    made = take(config or bench_rig.config(folder), **{"white": False, **fields})
    assert made.decodes_the_same()
    return made


def truth_of(pi: np.ndarray) -> np.ndarray:
    return np.asarray((pi * T).sum(axis=1).reshape(*GRID, 1))


@pytest.mark.parametrize(
    ("name", "family"), sampled(list(product(GOALS, ["isolation", "confocal"])), 3)
)
def test_a1_a2_path_isolation_gives_any_matrix_exactly(
    name: str, family: str, tmp_path: Path
) -> None:
    fields, pi = GOALS[name]
    made = run(tmp_path, family=family, **fields)
    scale = np.sqrt(np.mean(truth_of(np.abs(pi)) ** 2))
    off = np.sqrt(np.mean((made.image - truth_of(pi)) ** 2))
    assert off < 1e-3 * scale  # the RAW file is quantised
    for deviation in made.manifest.realised.values():
        assert max(deviation["off_max"], deviation["diagonal_max"]) < 1e-6  # single precision
    assert made.manifest.plan["family"] == family


def test_a1_every_pair_of_cells_has_a_slot_and_a_share_of_the_light() -> None:
    """N M slots; a path keeps 1 / (N M) of the time that guards leave."""
    request = request_of(goal="relit", matrix=np.ones((N, N)).tolist(), family="isolation")
    summary = make_plan(request, Config(), GRID).summary()
    assert summary.shots[0].codes == N * N
    assert summary.light_share == pytest.approx(1 / (3 * N * N), rel=1e-12)


def test_a1_signal_to_noise_collapses_with_the_light(tmp_path: Path) -> None:
    """144 slots of either kind at one aperture. A path has one slot by isolation and 36 by codes,
    so noise weighs 6 times more where it is photon noise and 36 times where it is the sensor's."""
    camera = CameraConfig(noise="full", f_number=9.0)
    noise = {}
    for family in ("hadamard", "isolation"):
        folder = tmp_path / family
        folder.mkdir()
        config = bench_rig.config(folder, camera=camera)
        made = run(folder, config, codes=N * N, family=family)
        off = np.sqrt(np.mean((made.image - truth_of(1.0 - np.eye(N))) ** 2))
        noise[family] = np.array([off, made.probe["sigma_sensor"].mean()])
    assert np.all(noise["isolation"] > 5.0 * noise["hadamard"])
    assert np.all(noise["isolation"] < 50.0 * noise["hadamard"])


def test_a2_proportional_isolation_has_slots_for_wanted_paths_only() -> None:
    """Confocal for the identity: N slots where the plain form has N M."""
    for family, slots in (("isolation", N * N), ("confocal", N)):
        asked = request_of(goal="diagonal", family=family, white=False)
        shots = make_plan(asked, Config(), GRID).summary().shots
        assert [shot.codes for shot in shots] == [slots] * 2


def test_a2_both_halves_of_a_signed_matrix_open_the_same_cells() -> None:
    """So that leaks and ambient light cancel in their difference."""
    goal = Target(Goal(name="relit"), GRID, matrices={"matrix": SIGNED})
    recipe = make_recipe(goal, CaptureScheme(codes=2, family="confocal"))
    halves = [recipe.programs[name] for name in ("relit-plus", "relit-minus")]
    nothing = np.zeros((0, 0), dtype=bool)
    (light, opened), (other, opened_too) = (
        program.pairs(nothing, Lattice(GRID)) for program in halves
    )
    np.testing.assert_array_equal(opened, opened_too)
    whole = np.asarray(opened, float).T @ (np.asarray(light) - np.asarray(other))
    np.testing.assert_allclose(whole * np.abs(SIGNED).max(), SIGNED, atol=1e-12)


@pytest.mark.parametrize(
    ("grid", "limit_s", "words"),
    [((48, 64), 600.0, "471859 s"), ((48, 64), 1e9, "memory"), ((3, 4), 5.0, "takes 7 s")],
)
def test_a1_isolation_of_too_many_pairs_is_refused_before_anything_is_built(
    grid: tuple[int, int], limit_s: float, words: str
) -> None:
    config = Config(limits=LimitsConfig(max_exposure_s=limit_s))
    with pytest.raises(RequestError, match=words):
        make_plan(CaptureRequest(goal="indirect", family="isolation"), config, grid)


def test_a4_patterns_are_there_before_the_shutter_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both sequences are stored and loaded first; every refresh is logged on both displays."""
    config = bench_rig.config(tmp_path)
    engine = Engine.from_config(config)
    engine.start()
    bench, rig = bench_rig.bench_of(engine), engine._rig
    seen: list[tuple[int, list[str]]] = []
    opens = rig.shutter.open

    def watched() -> int:
        stored = next(tmp_path.rglob("codes.npz"))
        loaded = rig.display._frames  # type: ignore[attr-defined]
        with np.load(stored) as codes:
            seen.append((len(loaded), sorted(codes.files)))
        return opens()

    monkeypatch.setattr(rig.shutter, "open", watched)
    request = CaptureRequest(goal="indirect", codes=8, white=False, black_level="none")
    result = bench_rig.capture(engine, request)
    assert result.error is None and result.folder is not None
    assert seen and all({"coded.primal", "coded.dual"} <= set(names) for _, names in seen)
    assert seen[-1][0] == 24 and bench.frames is not None
    with (Path(result.folder) / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(r["primal_shown"]) for r in rows] == list(range(24))
    assert [int(r["dual_shown"]) for r in rows] == list(range(24))
