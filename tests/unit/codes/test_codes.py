"""What every code family keeps: exact diagonals, on-counts, packing, seeds, refusals."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
import pytest

from pdcd.codes.make import CODE_FAMILIES, make_codes
from pdcd.errors import RequestError
from pdcd.protocol.fields import list_request_fields
from pdcd.words import FamilyName
from tests.unit.codes._oracles import probing

Dual = Literal["complement", "same"]
LATTICES = [(1, 1), (1, 9), (5, 7)]


ANY_COUNT = [name for name in CODE_FAMILIES if name != "singer"]
"""Families that take p = 1/2; `singer` has tests of its own."""


def test_families_are_those_that_requests_and_the_command_line_may_name() -> None:
    named = [name for name in get_args(FamilyName) if name not in ("isolation", "confocal")]
    assert list(CODE_FAMILIES) == named
    assert list(get_args(FamilyName)) == list(list_request_fields()["family"].words)


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("count", [2, 4, 12, 28, 128])
@pytest.mark.parametrize("family", ANY_COUNT)
def test_complement_codes_never_let_a_cell_see_itself(
    family: str, count: int, lattice: tuple[int, int]
) -> None:
    codes = make_codes(family, lattice, count, dual="complement", seed=3)
    assert np.array_equal(codes.dual, ~codes.primal)
    assert not np.diag(probing(codes)).any()


@pytest.mark.parametrize(
    ("family", "count", "p", "on"),
    [
        ("balanced", 8, 0.5, 4), ("balanced", 512, 0.0625, 32), ("balanced", 30, 0.1, 3),
        ("balanced", 9, 1 / 3, 3), ("hadamard", 2, 0.5, 1), ("hadamard", 28, 0.5, 14),
        ("hadamard", 128, 0.5, 64),
    ],
)  # fmt: skip
@pytest.mark.parametrize("lattice", LATTICES)
def test_same_codes_open_every_cell_equally_often(
    family: str, count: int, p: float, on: int, lattice: tuple[int, int]
) -> None:
    codes = make_codes(family, lattice, count, dual="same", p=p, seed=5)
    assert np.array_equal(codes.dual, codes.primal)
    assert np.all(codes.primal.sum(axis=0) == on)
    assert np.all(np.diag(probing(codes)) == on)


def test_bernoulli_lights_the_asked_share_of_cells() -> None:
    lit = make_codes("bernoulli", (40, 50), 100, dual="same", p=0.2, seed=2).primal
    assert abs(lit.mean() - 0.2) < 5 * np.sqrt(0.2 * 0.8 / lit.size)


@pytest.mark.parametrize("family", ["bernoulli", "rademacher", "balanced"])
def test_cells_are_independent_of_each_other(family: str) -> None:
    """Correlations between cells are those of unrelated sequences: squares average 1/(K-1)."""
    sign = 2.0 * make_codes(family, (20, 20), 200, dual="same", seed=4).primal - 1.0
    correlation = np.corrcoef(sign.T)[np.triu_indices(400, 1)]
    assert abs(correlation.mean()) < 5 / np.sqrt(199 * correlation.size)
    assert np.isclose((correlation**2).mean() * 199, 1.0, atol=0.05)


@pytest.mark.parametrize("family", ANY_COUNT)
def test_a_seed_always_gives_the_same_codes_and_another_seed_others(family: str) -> None:
    first, again, other = (
        make_codes(family, (12, 17), 32, dual="complement", seed=seed) for seed in (7, 7, 8)
    )
    assert np.array_equal(first.primal, again.primal)
    assert np.array_equal(first.dual, again.dual)
    assert (first.primal != other.primal).mean() > 0.3


@pytest.mark.parametrize("family", CODE_FAMILIES)
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"count": 0}, "0 codes"), ({"count": -4}, "-4 codes"), ({"lattice": (0, 5)}, "0 x 5"),
        ({"lattice": (5, 0)}, "5 x 0"), ({"p": 0.0}, "p = 0.0"), ({"p": 1.0}, "p = 1.0"),
        ({"p": float("nan")}, "p = nan"), ({"seed": -1}, "seed -1"),
        ({"dual": "other"}, "dual 'other'"),
    ],
)  # fmt: skip
def test_out_of_range_arguments_are_refused(
    family: str, change: dict[str, Any], words: str
) -> None:
    arguments: dict[str, Any] = {"lattice": (4, 4), "count": 8, "dual": "same"} | change
    with pytest.raises(RequestError) as caught:
        make_codes(family, **arguments)
    assert words in caught.value.message
    assert caught.value.hint


def test_an_unknown_family_is_refused_with_the_known_ones() -> None:
    with pytest.raises(RequestError, match=r"'fourier'.*bernoulli, rademacher, .* singer"):
        make_codes("fourier", (4, 4), 8, dual="same")


@pytest.mark.parametrize(
    ("p", "count", "hint"),
    [
        (0.0625, 100, "take 96 or 112 codes"), (0.5, 7, "take 6 or 8 codes"),
        (0.5, 1, "take 2 codes"), (0.25, 3, "take 4 codes"), (0.9, 1, "take 10 codes"),
        (0.99, 99_950, "take 99900 codes"), (1 / np.pi, 128, "simple fraction"),
        (1e-12, 8, "simple fraction"),
    ],
)  # fmt: skip
def test_balanced_names_the_counts_that_fit_p(p: float, count: int, hint: str) -> None:
    with pytest.raises(RequestError) as caught:
        make_codes("balanced", (4, 4), count, dual="same", p=p)
    assert hint in str(caught.value.hint)


def test_rademacher_refuses_shares_other_than_a_half() -> None:
    with pytest.raises(RequestError, match="equally often"):
        make_codes("rademacher", (4, 4), 8, dual="same", p=0.25)
