"""Slow pure functions of the program, worked out once for equal arguments in a test process.

Many tests photograph one of five scenes with the same codes. A scene is the same for the same grid
and options; a colouring for the same lattice, colours and state of its generator, which is left as
the function leaves it; the paths that a pilot finds for the same photos, as whoever decodes a run
right after its capture has them. Tests of the functions themselves call them where they are
defined, and so do the processes that tests start.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.codes import hadamard, singer
from pdcd.codes.colouring import colour_lattice
from pdcd.pictures import learn
from pdcd.virtual.scene.presets import PRESETS, Builder
from pdcd.virtual.scene.scene import Scene

SCENES, COLOURINGS, PATHS = 24, 512, 16
"""How many are kept; a scene of 48 x 64 cells takes tens of megabytes."""

Key = TypeVar("Key")
Value = TypeVar("Value")
Colouring = tuple[NDArray[np.int64], NDArray[np.int8]]


class Memory(Generic[Key, Value]):
    """The values that were asked for last."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Key, Value] = OrderedDict()

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of this key, made where it is not known."""
        value = self._kept.pop(key) if key in self._kept else make()
        self._kept[key] = value
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return value


def scene_builder(build: Builder, memory: Memory[str, Scene], name: str) -> Builder:
    """A builder that remembers; scenes are frozen, so one may be given to many."""

    def remembered(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
        key = repr((name, tuple(grid), sorted(options.items())))
        return memory.get(key, lambda: build(grid, options))

    return remembered


def colouring(memory: Memory[str, tuple[Colouring, Any]]) -> Callable[..., Colouring]:
    """`colour_lattice` that remembers what it is asked for without links."""

    def remembered(
        lattice: tuple[int, int],
        colours: int,
        rng: np.random.Generator,
        links: Any = None,
        **apart: Any,
    ) -> Colouring:
        if links is not None or apart:
            return colour_lattice(lattice, colours, rng, links, **apart)
        key = repr((tuple(lattice), colours, rng.bit_generator.state))

        def make() -> tuple[Colouring, Any]:
            made = colour_lattice(lattice, colours, rng)
            return made, rng.bit_generator.state

        (colour, sign), state = memory.get(key, make)
        rng.bit_generator.state = state
        return colour.copy(), sign.copy()

    return remembered


def paths(find: Callable[..., Any], memory: Memory[bytes, Any]) -> Callable[..., Any]:
    """A search for paths that remembers what it found in photos that are the same to the bit."""

    def remembered(codes: Any, photos: Any, grid: tuple[int, int], *, sigma: Any) -> Any:
        key = hashlib.sha256(repr((find.__name__, grid)).encode())
        for array in (codes, photos, sigma):
            key.update(repr((np.shape(array), np.asarray(array).dtype)).encode())
            key.update(np.asarray(array).tobytes())
        return memory.get(key.digest(), lambda: find(codes, photos, grid, sigma=sigma))

    return remembered


def begin() -> None:
    """Let the program remember in this process."""
    scenes: Memory[str, Scene] = Memory(SCENES)
    for name, build in PRESETS.items():
        PRESETS[name] = scene_builder(build, scenes, name)
    for module in (hadamard, singer):
        module.colour_lattice = colouring(Memory(COLOURINGS))  # type: ignore[attr-defined]
    found: Memory[bytes, Any] = Memory(PATHS)
    for name in ("match_links", "estimate_links"):
        setattr(learn, name, paths(getattr(learn, name), found))
