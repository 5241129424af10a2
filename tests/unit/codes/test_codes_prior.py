"""Codes from known links: linked cells never share a column, and everything else stays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pdcd.codes.hadamard import make_hadamard_codes, make_prior_codes, symmetrise_links
from pdcd.errors import RequestError
from tests.places import DATA


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def overlap(codes: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Scalar products of the +-1 columns over their length: (L, L), 0 for different columns."""
    sign = np.where(codes, 1.0, -1.0)
    return sign.T @ sign / len(codes)


def error(transport: NDArray[np.float64], codes: NDArray[np.bool_]) -> float:
    """RMS error of the indirect image over the RMS of the true one."""
    lit = codes.astype(np.float64)
    weight = (1.0 - lit).T @ lit
    cells = len(transport)
    image = (weight / (weight.sum() / (cells * (cells - 1))) * transport).sum(axis=1)
    truth = transport.sum(axis=1) - np.diag(transport)
    return float(np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)))


@settings(max_examples=40)
@given(
    rows=st.integers(1, 11),
    cols=st.integers(1, 11),
    count=st.sampled_from([4, 8, 12, 16]),
    seed=st.integers(0, 999),
)
def test_each_cell_has_a_column_that_is_orthogonal_or_its_own(
    rows: int, cols: int, count: int, seed: int
) -> None:
    cells = rows * cols
    links = scipy.sparse.random_array((cells, cells), density=0.1, rng=rng(seed))
    codes = make_prior_codes((rows, cols), count, links, rng(seed))
    assert codes.shape == (count, cells) and codes.dtype == np.bool_
    assert np.all(codes.sum(axis=0) == count // 2)
    assert np.isin(overlap(codes), (-1.0, 0.0, 1.0)).all()


@pytest.mark.parametrize("seed", range(3))
def test_cells_linked_by_a_permutation_never_share_a_column(seed: int) -> None:
    """One way is enough: the links have no symmetry."""
    target = rng(seed).permutation(20 * 30)
    links = scipy.sparse.csr_array((np.ones(600), (np.arange(600), target)), shape=(600, 600))
    other = np.flatnonzero(target != np.arange(600))
    shared = overlap(make_prior_codes((20, 30), 8, links, rng(seed)))[other, target[other]]
    assert not shared.any()
    # Without the links, seven columns for 600 cells do collide.
    assert overlap(make_hadamard_codes((20, 30), 8, 0.5, rng(seed)))[other, target[other]].any()


def test_stronger_links_are_kept_apart_before_weaker_ones() -> None:
    """Nine cells all linked, seven columns: two must share, and it is not the strong pair."""
    links = np.ones((9, 9))
    links[0, 8] = 5.0
    for seed in range(10):
        assert overlap(make_prior_codes((3, 3), 8, links, rng(seed)))[0, 8] == 0.0


def test_without_links_the_codes_are_the_plain_ones() -> None:
    none = scipy.sparse.csr_array((12 * 9, 12 * 9))
    assert np.array_equal(
        make_prior_codes((12, 9), 16, none, rng(4)), make_hadamard_codes((12, 9), 16, 0.5, rng(4))
    )


@pytest.mark.long
def test_known_transport_lowers_the_error_of_a_mirror_scene() -> None:
    """Eight codes with the whole transport known beat 128 without."""
    with np.load(DATA / "mirror_32x24.npz") as file:
        transport = np.asarray(file["transport"], dtype=np.float64)
    known = np.mean(
        [error(transport, make_prior_codes((24, 32), 8, transport, rng(s))) for s in (0, 1)]
    )
    plain = np.mean(
        [error(transport, make_hadamard_codes((24, 32), 128, 0.5, rng(s))) for s in (0, 1)]
    )
    assert known < plain


def test_links_become_symmetric_by_the_stronger_way() -> None:
    links = np.array([[9.0, 1.0, 0.0], [3.0, 9.0, 0.0], [0.0, 2.0, 0.0]])
    want = [[0.0, 3.0, 0.0], [3.0, 0.0, 2.0], [0.0, 2.0, 0.0]]
    found = symmetrise_links(links, 3)
    assert found.toarray().tolist() == want
    assert (found.nnz, found.format, found.dtype) == (4, "csr", np.float64)


@pytest.mark.parametrize(
    ("links", "words"),
    [
        (np.zeros((5, 5)), "6 cells"), (np.zeros((5, 6)), "6 cells"),
        (-np.ones((6, 6)), "negative"), (np.full((6, 6), np.nan), "not finite"),
        (np.full((6, 6), np.inf), "not finite"),
    ],
)  # fmt: skip
def test_unfit_links_are_refused(links: Any, words: str) -> None:
    with pytest.raises(RequestError, match=words) as caught:
        make_prior_codes((2, 3), 4, links, rng(0))
    assert caught.value.hint


def test_a_count_that_is_no_order_is_refused_with_its_neighbours() -> None:
    with pytest.raises(RequestError, match="take 8 or 12 codes"):
        make_prior_codes((4, 4), 10, np.ones((16, 16)), rng(0))


def test_parts_share_columns_between_other_cells_each() -> None:
    """Where every cell has a link of its own strength, these gave all parts the same columns; now
    pairs share one in two parts as often as chance has it, and linked cells still in none."""
    lattice, count, cells = (12, 16), 16, 192
    links = np.zeros((cells, cells))
    links[np.arange(cells), (np.arange(cells) + 70) % cells] = 1.0 + np.arange(cells) / cells

    def shared(apart: bool) -> list[NDArray[np.bool_]]:
        found = []
        for seed in range(2):
            same = overlap(make_prior_codes(lattice, count, links, rng(seed), apart=apart)) != 0.0
            found.append(same & ~np.eye(cells, dtype=np.bool_))
        return found

    first, second = shared(False)
    assert np.mean(second[first]) > 0.95
    first, second = shared(True)
    assert np.mean(second[first]) < 2.0 * np.mean(second)
    assert not (first | second)[links > 0.0].any()
