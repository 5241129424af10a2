"""Which shots, photos and pictures each goal and way of photographing has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes import each
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.programs import FloodlitProgram
from pdcd.recipes.recipe import Extremes

GRID = (4, 8)
N = 32
LIGHT = np.linspace(0.25, 1.0, N)


def target(name: str, **given: Any) -> Target:
    planes = {"illumination": given.pop("illumination")} if "illumination" in given else {}
    matrices = {"kernel": given.pop("kernel")} if "kernel" in given else {}
    return Target(Goal(name=name, **given), GRID, planes, matrices)  # type: ignore[arg-type]


def test_stripes_move_by_a_quarter_of_their_period() -> None:
    recipe = make_recipe(target("split", period=8), CaptureScheme())
    names = tuple(f"stripes-{k}" for k in range(4))
    assert recipe.pictures == {
        "high": Extremes(1.0, -1.0, names),
        "low": Extremes(0.0, 2.0, names),
        "indirect": tuple((0.5, name) for name in names),
    }
    for step, photo in enumerate(recipe.photos):
        lit = [((col + 2 * step) % 8) < 4 for col in range(8)] * 4
        np.testing.assert_array_equal(photo.wanted.light, np.array(lit, float))
    assert recipe.main == "stripes-3"
    with pytest.raises(RequestError, match="no sum of photos"):
        _ = recipe.wanted


def test_a_kernel_over_the_whole_grid_is_the_sum_of_its_taps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With very many taps it is convolved."""
    kernel = np.random.default_rng(1).standard_normal((7, 15))
    made = []
    for many_taps in (10**9, 1):
        monkeypatch.setattr(each, "MANY_TAPS", many_taps)
        made.append(make_recipe(target("filtered", kernel=kernel), CaptureScheme(codes=16)))
    single, whole = made
    assert len(single.wanted.parts) == 7 * 15 and len(whole.wanted.parts) == 1
    np.testing.assert_array_equal(whole.wanted.dense(), single.wanted.dense())
    lattice = Lattice(GRID, "quarter")
    bits = np.random.default_rng(3).random((16, lattice.lattice_cells)) < 0.5
    for name, program in single.programs.items():
        wanted, found = program.pairs(bits, lattice), whole.programs[name].pairs(bits, lattice)
        np.testing.assert_array_equal(found[0], wanted[0])
        np.testing.assert_allclose(found[1], wanted[1], atol=1e-14)


@pytest.mark.parametrize(
    ("goal", "numbers", "scaled"),
    [
        ("split", {"period": 4}, True), ("fraction", {"p": 0.25, "shift": (0, 1)}, True),
        ("fraction", {"p": 0.25}, False),
    ],
)  # fmt: skip
def test_what_windows_smear_is_scaled_by_all_its_light(
    goal: str, numbers: dict[str, Any], scaled: bool
) -> None:
    """Stripes, and matched cells beside a share of the rest: half of the light of a matched cell
    comes from those beside it."""
    recipe = make_recipe(target(goal, **numbers), CaptureScheme())
    assert {photo.wanted.by_light for photo in recipe.photos} == {scaled}


def test_a_pilot_comes_before_the_coded_shots() -> None:
    recipe = make_recipe(target("indirect"), CaptureScheme(codes=12, pilot=3))
    pilots = [f"pilot-{k:04d}" for k in (1, 2, 3)]
    assert [shot.name for shot in recipe.shots] == ["white", *pilots, "coded"]
    assert [shot.only for shot in recipe.shots] == [None, 0, 1, 2, None]
    assert recipe.stack == tuple(pilots) and not recipe.sums
    assert isinstance(recipe.programs["pilot"], FloodlitProgram)
    for wrong in ("fraction", "diagonal"):
        with pytest.raises(RequestError, match="takes no pilot"):
            make_recipe(
                target(wrong, p=0.5 if wrong == "fraction" else None), CaptureScheme(pilot=3)
            )
    with pytest.raises(RequestError, match="neither a shift nor a warp"):
        make_recipe(target("indirect", shift=(0, 1)), CaptureScheme(pilot=3))


def test_a_pilot_of_all_codes_is_masked_in_software() -> None:
    all_codes = CaptureScheme(codes=8, pilot=8)
    assert all_codes.coded == 0
    for name in ("indirect", "direct"):
        recipe = make_recipe(target(name), all_codes)
        assert "coded" not in recipe.programs and "coded" not in [s.name for s in recipe.shots]
        assert recipe.sums["coded"].direct == 0.0  # type: ignore[union-attr]
        assert recipe.sums["coded"].indirect == 1.0  # type: ignore[union-attr]
    with pytest.raises(RequestError, match="leaves no codes for the goal short-range"):
        make_recipe(target("short-range", radius=1), all_codes)
    for how, given in (
        (CaptureScheme(codes=8, pilot=8, black_level="mask"), {}),
        (all_codes, {"illumination": LIGHT}),
    ):
        with pytest.raises(RequestError, match="neither black exposures nor an illumination"):
            make_recipe(target("indirect", **given), how)
