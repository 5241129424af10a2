"""Keywords that are wrong: all of them are named at once, each in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.api.arguments import make_request
from pdcd.errors import RequestError


def grid() -> tuple[int, int]:
    return 2, 3


def faults(goal: Any, /, **arguments: Any) -> list[str]:
    with pytest.raises(RequestError) as caught:
        make_request(goal, arguments, grid)
    assert caught.value.hint == "docs/request.md lists goals and keywords"
    return caught.value.message.split("\n")


def test_all_faults_are_told_one_a_line() -> None:
    told = faults("whit", code=4, parts="many", goal="white", kernel=[[1j]], seed=None)
    assert len(told) == 5
    assert told[0] == "whit: no such goal; is white meant?"
    assert told[1] == "code: no such keyword; is codes meant?"
    assert told[2].startswith("parts: ")
    assert told[3].startswith("goal: no such keyword")
    assert told[4].startswith("kernel: must be rows and columns of real numbers")


@pytest.mark.parametrize("rows", [[[1.0], [1.0, 2.0]], [1.0, 2.0], 5.0, [["a", "b"]]])
def test_what_is_no_array_is_named(rows: Any) -> None:
    told = faults("filtered", kernel=rows)
    assert told and all(line.startswith("kernel: ") for line in told)


@pytest.mark.parametrize("prior", [[["a"]], [[object()]], [[1.0], [1.0, 2.0]]])
def test_a_prior_that_is_no_matrix_is_named(prior: Any) -> None:
    (told,) = faults("indirect", prior=prior)
    assert told.startswith("prior: ")


def test_the_grid_is_asked_for_only_where_a_prior_is_an_array() -> None:
    def never() -> tuple[int, int]:
        raise AssertionError("the rig was asked")

    make_request("indirect", {"prior": "decay:3"}, never)
    make_request("indirect", {"prior": Path("t.npz")}, never)
    make_request("filtered", {"kernel": np.ones((3, 3))}, never)
    with pytest.raises(AssertionError):
        make_request("indirect", {"prior": np.eye(6)}, never)
