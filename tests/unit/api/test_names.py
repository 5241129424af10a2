"""The public names: all there, keywords as requests have them, nothing loaded before its time."""

from __future__ import annotations

import functools
import operator
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import pytest
from numpy.typing import ArrayLike, NDArray

import pdcd
from pdcd.api.arguments import Arguments, ArrayArgument
from pdcd.protocol.fields import list_request_fields


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


WIDER = {
    "plane": ArrayLike, "prior": str | Path | NDArray[Any], "out": str | Path,
    "tags": str | Sequence[str], "codes_from": str | Path | tuple[ArrayLike, ArrayLike],
}  # fmt: skip
"""Keywords that take more than the field: `pdcd.api.arguments` makes of it what a request has."""


def bare(kind: Any) -> Any:
    """A type without bounds and texts, and without None."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return bare(parts[0])
    if origin in (Union, UnionType):
        return functools.reduce(operator.or_, (bare(p) for p in parts if p is not NoneType))
    return tuple[tuple(map(bare, parts))] if origin is tuple else kind  # type: ignore[misc]


def test_the_keywords_are_the_fields_of_a_request_with_their_types() -> None:
    fields = list_request_fields()
    wanted = {
        name: WIDER.get(name, ArrayArgument if field.kind == "array" else bare(field.type))
        for name, field in fields.items()
        if name != "goal"
    }
    assert get_type_hints(Arguments) == wanted
    assert list(Arguments.__annotations__) == list(wanted)
