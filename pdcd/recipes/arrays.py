"""Arrays that a request names: images, `.npy` files or lists -> float64, shape-checked later."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.recipes.goals import MATRICES, PLANES, Target, check_target
from pdcd.request import CaptureRequest, Goal

Floats = NDArray[np.float64]
Given = str | tuple[tuple[float, ...], ...]
"""A path, or rows of numbers."""


def load(name: str, given: Given) -> Floats:
    """A two-dimensional array. Images become grey, full scale 1. Raises ConfigError."""
    if not isinstance(given, str):
        if len({len(row) for row in given}) != 1:
            raise ConfigError(f"{name} has rows of unequal length", hint="give a full rectangle")
        return np.array(given, dtype=np.float64)
    path = Path(given)
    try:
        data = path.read_bytes()
    except OSError as err:
        raise ConfigError(
            f"cannot read {name} from {path}: {err.strerror}", hint="give an absolute path"
        ) from err
    array = _numpy(name, path) if path.suffix == ".npy" else _image(name, path, data)
    if array.ndim != 2:
        raise ConfigError(f"{name} in {path} has {array.ndim} dimensions, not 2")
    return array


def _numpy(name: str, path: Path) -> Floats:
    try:
        return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
    except (OSError, ValueError, EOFError, TypeError) as err:
        raise ConfigError(f"{name}: {path} is no array of numbers", hint=str(err)) from err


def _image(name: str, path: Path, data: bytes) -> Floats:
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_ANYDEPTH)
    if image is None:
        raise ConfigError(
            f"{name}: {path} is no image",
            hint="take PNG, TIFF or another format of OpenCV, or .npy",
        )
    full = {"uint8": 255.0, "uint16": 65535.0}.get(str(image.dtype), 1.0)
    return image.astype(np.float64) / full


def target_of(request: CaptureRequest, grid: tuple[int, int]) -> Target:
    """What a request asks for, with all its arrays read. Raises ConfigError."""
    given = {name: getattr(request, name) for name in (*PLANES, *MATRICES)}
    arrays = {name: load(name, v) for name, v in given.items() if v is not None}
    for name in PLANES:
        if name in arrays and arrays[name].shape != grid:
            raise ConfigError(
                f"{name} is {arrays[name].shape[0]} x {arrays[name].shape[1]}, the grid is "
                f"{grid[0]} x {grid[1]} cells",
                hint="give one value for each cell",
            )
    goal = Goal(
        name=request.goal,
        p=request.p,
        shift=request.shift,
        radius=request.radius,
        mix=request.mix,
        period=request.period,
    )
    return check_target(target_with(goal, grid, arrays))


def target_with(goal: Goal, grid: tuple[int, int], arrays: Mapping[str, Floats]) -> Target:
    """A goal over a grid with these arrays by name, planes of any shape; nothing is checked."""
    planes = {name: a.ravel() for name, a in arrays.items() if name in PLANES}
    return Target(goal, grid, planes, {name: a for name, a in arrays.items() if name in MATRICES})
