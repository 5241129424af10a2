"""Keywords of a capture -> a request and its arrays, all checked before a bench is asked."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.bench.reading import describe_unknown_key
from pdcd.errors import RequestError
from pdcd.files.opening import Sendable
from pdcd.protocol.fields import Field, FieldError, list_request_fields
from pdcd.protocol.request import CaptureRequest
from pdcd.words import (
    BlackLevelName,
    FamilyName,
    GuardsName,
    KeepName,
    KeepRawName,
    MethodName,
    NormaliseName,
    WindowName,
)

ArrayArgument = ArrayLike | Path
"""An array, rows of numbers, or the path of a .npy, .npz or PNG file."""


class Arguments(TypedDict, total=False):
    """What a capture takes besides its goal, spelt out for type checkers and editors.

    Names and types are those of the fields of `pdcd.protocol.request.CaptureRequest`, which a test
    checks; docs/request.md explains them. Arrays may also be given as arrays.
    """

    codes: int
    family: FamilyName
    codes_from: str | Path | tuple[ArrayLike, ArrayLike]
    p: float
    shift: tuple[int, int]
    equal_brightness: bool
    radius: int
    mix: tuple[float, float]
    period: int
    disparity: tuple[int, int]
    plane: ArrayLike
    keep: KeepName
    rows: tuple[int, int]
    masked: bool
    illumination: ArrayArgument
    disparities: ArrayArgument
    warp: ArrayArgument
    warp_b: ArrayArgument
    region_a: ArrayArgument
    region_b: ArrayArgument
    kernel: ArrayArgument
    matrix: ArrayArgument
    method: MethodName
    pilot: int | Literal["auto"]
    parts: int | Literal["auto"]
    until_error: float
    repeat: int
    error: float
    confidence: float
    seconds: float
    prior: str | Path | NDArray[Any]
    smooth: bool
    grey_masks: bool
    seed: int
    exposure_s: float
    window: WindowName
    guards: bool | GuardsName
    black_level: BlackLevelName
    normalise: NormaliseName
    white: bool
    white_patch: tuple[float, float]
    keep_raw: KeepRawName
    out: str | Path
    name: str
    tags: str | Sequence[str]
    note: str


def make_request(
    goal: str, arguments: Mapping[str, Any], grid: Callable[[], tuple[int, int]]
) -> tuple[CaptureRequest, dict[str, Sendable]]:
    """The request that a goal and keywords make, and its arrays by field.

    grid : returns rows and columns of the rig's cells; called where a prior is given as an array.

    Raises RequestError naming all faults, one a line.
    """
    fields = list_request_fields()
    keywords = [name for name in fields if name != "goal"]
    goals = fields["goal"].words
    faults: list[str] = []
    values: dict[str, Any] = {"goal": goal}
    arrays: dict[str, Sendable] = {}
    if goal not in goals:
        faults.append(
            describe_unknown_key(str(goal), str(goal), goals).replace("no such key", "no such goal")
        )
    for name, value in arguments.items():
        if name not in keywords:
            faults.append(
                describe_unknown_key(str(name), str(name), keywords).replace("key", "keyword")
            )
        elif value is None:
            continue
        elif fields[name].kind == "array":
            arrays[name] = _array(name, value, faults)
        elif fields[name].kind == "file" and fields[name].is_file(value):
            packed = _pack_pair if name == "codes_from" else partial(_pack_transport, grid)
            arrays[name] = _file(name, value, packed, faults)
        else:
            try:
                values[name] = fields[name].convert(_row(to_json_types(value), fields[name]))
            except FieldError as err:
                faults.append(str(err))
    if faults:
        raise RequestError("\n".join(faults), hint="docs/request.md lists goals and keywords")
    if "out" in values:
        values["out"] = os.fspath(Path(values["out"]).absolute())
    return CaptureRequest(**values), arrays


def to_json_types(value: Any) -> Any:
    """The value in types of JSON; it may hold types of numpy and pathlib, in tables and rows."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(key): to_json_types(held) for key, held in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_types(held) for held in value]
    return value


def _row(value: Any, field: Field) -> Any:
    """The value; a single word where a row of words is wanted becomes a row of one word."""
    return [value] if field.kind == "words" and isinstance(value, str) else value


def _array(name: str, value: Any, faults: list[str]) -> Sendable:
    if isinstance(value, str | os.PathLike):
        return Path(value)
    try:
        found = np.asarray(value)
    except ValueError as err:  # rows of unequal length
        faults.append(f"{name}: {err}")
        return np.zeros((0, 0))
    if found.dtype.kind not in "biuf" or found.ndim != 2:
        faults.append(f"{name}: must be rows and columns of real numbers, or the path of a file")
    return found


def _file(
    name: str, value: Any, packed: Callable[[Any], dict[str, NDArray[Any]]], faults: list[str]
) -> Sendable:
    """A file of arrays: the named file, or the bytes of a file with the given arrays."""
    if isinstance(value, str | os.PathLike):
        return Path(value)
    try:
        arrays = packed(value)
    except (TypeError, ValueError) as err:
        faults.append(f"{name}: {err}")
        return b""
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def _pack_transport(grid: Callable[[], tuple[int, int]], prior: Any) -> dict[str, NDArray[Any]]:
    """A prior in the form of a scene's file."""
    return {"transport": np.asarray(prior, dtype=np.float64), "grid": np.array(grid())}


def _pack_pair(value: Any) -> dict[str, NDArray[Any]]:
    """Codes of projector and mask. Raises ValueError unless it is a pair of arrays of numbers."""
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ValueError("it takes the path of a file, or two arrays (primal, dual)")
    pair = dict(zip(("primal", "dual"), map(np.asarray, value), strict=True))
    for name, array in pair.items():
        if array.dtype.kind not in "biuf":
            raise ValueError(f"{name} must be an array of real numbers")
    return pair
