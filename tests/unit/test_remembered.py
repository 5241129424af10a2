"""What tests remember of the program is what it would work out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.codes import hadamard, singer
from pdcd.codes.colouring import colour_lattice
from pdcd.virtual.scene.scene import Scene
from tests.remembered import Memory, colouring, scene_builder


def test_a_colouring_is_the_same_and_leaves_the_generator_the_same() -> None:
    again = colouring(Memory(4))
    plain, first, second = (np.random.default_rng(3) for _ in range(3))
    wanted = [colour_lattice((6, 8), count, plain) for count in (7, 7, 15)]
    for rng in (first, second):  # the second time from memory
        for count, (colour, sign) in zip((7, 7, 15), wanted, strict=True):
            found = again((6, 8), count, rng)
            np.testing.assert_array_equal(found[0], colour)
            np.testing.assert_array_equal(found[1], sign)
            found[0][:] = -1  # whoever got it may write on it
        assert rng.bit_generator.state == plain.bit_generator.state


def test_the_families_use_it() -> None:
    for module in (hadamard, singer):
        assert module.colour_lattice is not colour_lattice


def test_a_scene_is_built_once_for_the_same_grid_and_options() -> None:
    built: list[tuple[Any, ...]] = []

    def build(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
        built.append((grid, dict(options)))
        return Scene("s", grid, ())

    remembered = scene_builder(build, Memory(2), "s")
    one = remembered((3, 4), {"a": [1]})
    assert remembered((3, 4), {"a": [1]}) is one
    assert remembered((3, 4), {"a": [2]}) is not one
    assert remembered((4, 3), {"a": [1]}).grid == (4, 3)
    remembered((3, 4), {"a": [1]})  # forgotten meanwhile
    assert [options for _, options in built] == [{"a": [1]}, {"a": [2]}, {"a": [1]}, {"a": [1]}]
