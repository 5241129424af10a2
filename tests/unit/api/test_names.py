"""The public names: all there, keywords as requests have them, nothing loaded before its time."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import pdcd
from pdcd.api.arguments import FIELDS, Arguments, asked
from pdcd.errors import RequestError
from pdcd.protocol.request import ARRAYS, CaptureRequest


def test_import_pdcd_loads_next_to_nothing() -> None:
    code = "import sys; before = {*sys.modules}; import pdcd; print(*{*sys.modules} - before)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert {name for name in loaded if name.startswith("pdcd")} == {"pdcd", "pdcd.version"}
    assert not loaded & {"numpy", "msgspec", "scipy", "cv2", "rich", "IPython", "asyncio"}


def test_every_public_name_is_there() -> None:
    for name in pdcd.__all__:
        assert getattr(pdcd, name) is getattr(pdcd, name)
    assert {*pdcd.__all__} <= {*dir(pdcd)}
    with pytest.raises(AttributeError, match="no attribute 'opne'"):
        pdcd.opne  # type: ignore[attr-defined]  # noqa: B018


def test_the_keywords_are_the_fields_of_a_request() -> None:
    assert {"goal", *Arguments.__annotations__} == {*FIELDS}


def _grid() -> tuple[int, int]:
    return 2, 3


def test_keywords_become_a_request_and_its_arrays() -> None:
    plane = np.ones((2, 3))
    patch = np.array([0.25, 0.5])
    given = {"codes": np.int64(8), "illumination": plane, "white_patch": patch, "p": None}
    request, arrays = asked("illuminated", given, _grid)
    assert request == CaptureRequest(goal="illuminated", codes=8, white_patch=(0.25, 0.5))
    assert arrays["illumination"] is plane


def test_every_array_may_be_rows_or_a_path() -> None:
    for name in ARRAYS:
        _, arrays = asked("relit", {name: [[1.0, 0.0]]}, _grid)
        assert np.array_equal(np.asarray(arrays[name]), [[1.0, 0.0]])
        _, arrays = asked("relit", {name: "here.npy"}, _grid)
        assert str(arrays[name]) == "here.npy"


@pytest.mark.parametrize(
    ("goal", "arguments", "told"),
    [
        ("indirekt", {}, "no such goal; is indirect meant?"),
        ("indirect", {"code": 8}, "code: no such keyword; is codes meant?"),
        ("indirect", {"codes": "many"}, "codes: expected"),
        ("indirect", {"codes": 0}, "codes: expected"),
        ("indirect", {"family": "best"}, "allowed are bernoulli"),
        ("filtered", {"kernel": [[1.0], [1.0, 2.0]]}, "kernel: "),
        ("filtered", {"kernel": [1.0, 2.0]}, "kernel: must be rows and columns"),
        ("filtered", {"kernel": np.array([["a"]])}, "kernel: must be rows and columns"),
        ("indirect", {"prior": np.array([["a"]])}, "prior: "),
    ],
)
def test_a_wrong_keyword_is_named(goal: str, arguments: dict[str, Any], told: str) -> None:
    with pytest.raises(RequestError, match=told.replace("?", r"\?")):
        asked(goal, arguments, _grid)


def test_all_faults_are_named_at_once() -> None:
    with pytest.raises(RequestError) as caught:
        asked("white", {"code": 8, "seed": -1}, _grid)
    assert len(caught.value.message.splitlines()) == 2
