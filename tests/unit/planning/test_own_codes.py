"""Codes that came with a request: those of a family give its patterns, and what is refused."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import Config
from pdcd.codes.make import make_codes
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.planning.defaults import is_search_needed
from pdcd.planning.given import make_text_source, read_request_arrays
from pdcd.planning.make import plan_request
from pdcd.planning.plan import Plan
from pdcd.protocol.request import CaptureRequest, SentArray
from pdcd.recipes.parts import derive_part_seed

GRID, COUNT, SEED = (6, 8), 16, 5
BITS = np.random.default_rng(0).random((COUNT, *GRID)) < 0.5


def encode(**arrays: Any) -> str:
    """The base64 of an .npz file."""
    import base64

    file = io.BytesIO()
    np.savez(file, **arrays)
    return base64.b64encode(file.getvalue()).decode()


def plan_own(primal: Any, dual: Any, **fields: Any) -> Plan:
    """The plan of a request that brings these codes."""
    source = make_text_source(encode(primal=primal, dual=dual), "own.npz")
    asked = CaptureRequest(
        **{"goal": "indirect", "codes_from": SentArray(npy="x"), "seed": SEED, **fields}
    )
    request, given = read_request_arrays(asked, {"codes_from": source}, GRID)
    assert not is_search_needed(request)
    return plan_request(request, Config(), GRID, None, None, given)


def throw_coins(shape: tuple[int, int], dual: Any, p: float, parts: int) -> list[NDArray[Any]]:
    """Codes of a plan of the family bernoulli, as a file may have them."""
    seeds = [derive_part_seed(SEED, parts, part) for part in range(1, parts + 1)]
    made = [
        make_codes("bernoulli", shape, COUNT // parts, dual=dual, p=p, seed=seed) for seed in seeds
    ]
    sides = ([getattr(one, side) for one in made] for side in ("primal", "dual"))
    return [np.concatenate(side).reshape(COUNT, *shape) for side in sides]


@pytest.mark.parametrize(
    ("fields", "dual"),
    [
        ({"goal": "indirect"}, "complement"),
        ({"goal": "indirect", "window": "quarter"}, "complement"),
        ({"goal": "direct", "parts": 4}, "complement"),
        ({"goal": "split", "period": 4}, "complement"),
        ({"goal": "indirect", "illumination": tuple((0.25,) * 8 for _ in range(6))}, "complement"),
        ({"goal": "fraction", "p": 0.25}, "same"),
    ],
)
def test_codes_of_a_family_in_a_file_are_shown_as_the_family_is(
    fields: dict[str, Any], dual: str
) -> None:
    fields = {"parts": 1, "pilot": 0, "window": "whole", **fields}
    wanted = plan_request(
        CaptureRequest(codes=COUNT, family="bernoulli", seed=SEED, **fields), Config(), GRID, None,
        None,
    )  # fmt: skip
    shape = Lattice(GRID, fields["window"]).shape
    found = plan_own(*throw_coins(shape, dual, fields.get("p", 0.5), fields["parts"]), **fields)
    assert found.recipe.shots == wanted.recipe.shots and found.family == "given"
    for name, pair in wanted.patterns.items():
        for made, own in zip(pair, found.patterns[name], strict=True):
            assert made.dtype == own.dtype and np.array_equal(made, own)
    assert found.summary().seconds == wanted.summary().seconds


def test_codes_of_the_grid_serve_every_window_and_may_be_grey_or_flat() -> None:
    whole, cut = (plan_own(BITS, ~BITS, window=window) for window in ("whole", "quarter"))
    packed = np.asarray(cut.patterns["coded"][0], dtype=np.uint8)
    lattice = np.unpackbits(packed, axis=1)[:, :63].reshape(-1, 7, 9)
    assert np.array_equal(lattice, np.pad(BITS, ((0, 0), (0, 1), (0, 1)), mode="edge"))
    flat = plan_own(BITS.reshape(COUNT, -1), ~BITS.reshape(COUNT, -1), window="whole")
    assert np.array_equal(flat.patterns["coded"][1], whole.patterns["coded"][1])
    grey = plan_own(BITS * 0.25, ~BITS * 1.0, window="whole")
    assert np.array_equal(grey.patterns["coded"][0], (BITS * 0.25).reshape(COUNT, -1))
    assert grey.p == pytest.approx(0.25 * BITS.mean())


@pytest.mark.parametrize("count", [64, 256])
def test_what_codes_err_by_is_worked_out_of_them(count: int) -> None:
    """Coins leave a variance of (S^2 + 2 Q) / K, with the 50 paths that are guessed."""
    bits = np.random.default_rng(count).random((count, *GRID)) < 0.5
    (line,) = (text for text in plan_own(bits, ~bits).reasons if text.startswith("codes: "))
    told = float(line.split("error is ")[1].split(" %")[0])
    assert told == pytest.approx(100.0 * np.sqrt((1.0 + 2.0 / 50.0) / count), rel=0.15)


def spoil(value: float) -> NDArray[np.float64]:
    """The codes with one level that is none."""
    levels = BITS.astype(float)
    levels[3, 2, 1] = value
    return levels


@pytest.mark.parametrize(
    ("primal", "dual", "what"),
    [
        (spoil(np.nan), ~BITS, "`primal`: it has 1 values that are not finite.*3, 2, 1"),
        (spoil(-0.5), ~BITS, "`primal` has 1 values below 0 or above 1.*3, 2, 1"),
        (BITS, spoil(1.5), "`dual` has 1 values below 0 or above 1"),
        (BITS, ~BITS[:-1], "the shapes 16 x 6 x 8 and 15 x 6 x 8"),
        (BITS[:0], BITS[:0], "0 x 6 x 8, which holds no number"),
        (BITS[0, 0], BITS[0, 0], "has 1 dimensions"),
        (np.zeros((2**17, 65), bool), BITS, "at most 8388608 numbers"),
        (BITS * 0, BITS, "`primal` is black throughout"),
        (BITS, np.array([None]), "`dual`: it holds object, not real numbers"),
        (BITS[:, :5], ~BITS[:, :5], "codes of 5 x 8 cells; the grid is 6 x 8"),
        (np.eye(48), np.eye(48), "keep no light that goal indirect wants"),
    ],
)
def test_codes_that_cannot_be_shown_are_refused_by_name(primal: Any, dual: Any, what: str) -> None:
    with pytest.raises(RequestError, match=rf"^codes_from.*{what}") as caught:
        plan_own(primal, dual)
    assert caught.value.hint


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"goal": "diagonal"}, "goal diagonal"), ({"goal": "white"}, "goal white"),
        ({"codes": 8}, "codes does not go"), ({"family": "hadamard"}, "family does not go"),
        ({"pilot": 8}, "pilot does not go"), ({"prior": "decay:3"}, "prior does not go"),
        ({"method": "pairs"}, "method does not go"), ({"parts": 3}, "shared out to 3 parts"),
        ({"equal_brightness": True}, "equal_brightness does not go"),
        ({"parts": "auto"}, "parts cannot be left"),
    ],
)  # fmt: skip
def test_what_goes_with_no_codes_of_ones_own(fields: dict[str, Any], what: str) -> None:
    with pytest.raises(RequestError, match=what) as caught:
        plan_own(BITS, ~BITS, **fields)
    assert "codes_from" in caught.value.message and caught.value.hint
    for name in ("error", "seconds"):
        asked: dict[str, Any] = {name: 0.5}
        with pytest.raises(RequestError, match="codes_from and"):
            is_search_needed(CaptureRequest(goal="indirect", codes_from="x.npz", **asked))
