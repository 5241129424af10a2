"""One panel's part of a window, on a graphics card that takes note: textures, uniforms, stages."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import moderngl
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.map import Map, PanelView
from pdcd.presenter.viewport import Viewport

SIZE_PX = (16, 12)

GRID = (3, 4)

BITS = np.packbits(np.arange(36).reshape(3, 12) % 5 == 0, axis=1)
"""Three patterns of twelve cells, two bytes each."""


class Uniform:
    """Remembers what it was given."""

    def __init__(self) -> None:
        self.written: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.written.append(data)


class Program(dict[str, Any]):
    """A shader: its uniforms, and its source."""

    def __init__(self, source: str) -> None:
        super().__init__(frame=Uniform())
        self.source = source


class Card:
    """Stands in for a context; `done` is what was drawn and let go of, in order."""

    def __init__(self, largest: int = 16384) -> None:
        self.info = {"GL_MAX_TEXTURE_SIZE": largest}
        self.done: list[Any] = []
        self.programs: list[Program] = []
        self.textures: list[Any] = []
        self.viewport: Any = None
        self.screen = SimpleNamespace(use=lambda: self.done.append("screen"))

    def program(self, vertex: str, fragment: str) -> Program:
        self.programs.append(Program(fragment))
        return self.programs[-1]

    def vertex_array(self, program: Program, content: list[Any]) -> Any:
        stage = "pieces" if program is self.programs[0] else "panel"
        assert content == []

        def render(mode: int, vertices: int) -> None:
            assert (mode, vertices) == (moderngl.TRIANGLES, 3)
            self.done.append(stage)

        return SimpleNamespace(render=render)

    def texture(
        self, size: tuple[int, int], channels: int, data: Any, dtype: str, alignment: int
    ) -> Any:
        made = SimpleNamespace(
            size=size, channels=channels, data=np.array(data), dtype=dtype, alignment=alignment,
            filter=None, unit=None,
        )  # fmt: skip
        made.use = lambda unit: setattr(made, "unit", unit)
        made.release = lambda: self.done.append(("release", made.unit))
        self.textures.append(made)
        return made

    def framebuffer(self, attachments: list[Any]) -> Any:
        number = len([what for what in self.done if what[0] == "canvas"])
        self.done.append(("canvas", *attachments))
        return SimpleNamespace(
            use=lambda: self.done.append("canvas"),
            release=lambda: self.done.append(("release canvas", number)),
        )

    def told(self) -> list[Any]:
        found, self.done = self.done, []
        return found


def frames(**changed: Any) -> Frames:
    """Rows: pattern 2, black, white, pattern 0 shifted."""
    index = np.array([2, BLACK, WHITE, 0], dtype=np.int32)
    made = Frames(
        primal_patterns=BITS, dual_patterns=BITS[::-1].copy(), primal_index=index,
        dual_index=index[::-1].copy(), shift=np.array([0, 0, 0, 3], dtype=np.uint8),
        code=np.zeros(4, dtype=np.int32), guard=np.zeros(4, dtype=bool), grid=GRID, lattice=GRID,
        window="whole",
    )  # fmt: skip
    return replace(made, **changed)


def view(role: str = "projector") -> PanelView:
    return PanelView(role, Map.filling(SIZE_PX))  # type: ignore[arg-type]


def viewport(
    card: Card, role: str = "projector", unit: int = 0, order: str | None = None
) -> Viewport:
    return Viewport(card, view(role), (5, 7), unit, order)  # type: ignore[arg-type]


def drawn(made: Viewport, card: Card, number: int) -> list[Any]:
    card.told()
    made.draw_pieces(number)
    made.draw(number)
    return card.told()


@pytest.mark.parametrize(("size", "rows"), [(16384, 1), (16385, 2)])
def test_a_texture_has_as_many_rows_as_its_bytes_need(size: int, rows: int) -> None:
    card = Card(3)
    patterns = np.full((1, size), 7, dtype=np.uint8)
    made = viewport(card)
    made._upload(patterns)
    assert card.textures[0].size == (4096, rows)
    assert card.textures[0].data.view(np.uint8).sum() == 7 * size
    card.info["GL_MAX_TEXTURE_SIZE"] = rows - 1
    with pytest.raises(ConfigError) as told:
        made._upload(patterns)
    assert told.value.message == (
        f"{size} bytes of patterns exceed the graphics card's textures ({16384 * (rows - 1)} bytes)"
    )
    assert told.value.device == "projector" and "more parts" in str(told.value.hint)


def test_a_geometry_is_kept_while_it_is_the_same_and_let_go_of_with_the_next() -> None:
    card = Card()
    made = viewport(card)
    made.load(frames())
    card.told()
    made.load(frames())
    assert card.told() == [("release", 0)] and len(card.textures) == 4
    made.load(frames(window="quarter"))
    assert card.told() == [
        ("release", 0), ("release", 1), ("release", 2), ("release canvas", 0),
        ("canvas", card.textures[-1]),
    ]  # fmt: skip
    assert len(card.textures) == 7


def test_pieces_that_exceed_a_texture_are_refused_and_the_next_geometry_is_made_anew() -> None:
    card = Card(16)
    made = viewport(card)
    made.load(frames())  # 16 pixels across, as many as a texture has
    card.info["GL_MAX_TEXTURE_SIZE"] = 15
    with pytest.raises(ConfigError) as told:
        made.load(frames(window="quarter"))
    assert told.value.message == (
        "16 pixels or pieces along an axis exceed the graphics card's textures (15)"
    )
    assert told.value.device == "projector" and told.value.hint == "use a coarser grid"
    card.info["GL_MAX_TEXTURE_SIZE"] = 16
    count = len(card.textures)
    made.load(frames())
    assert len(card.textures) == count + 3


def test_black_is_black_before_any_patterns_are_there() -> None:
    card = Card()
    made = viewport(card)
    made.prepare(np.full((2, 1), BLACK, dtype=np.int32))
    assert drawn(made, card, 0) == drawn(made, card, 1) == []
