"""Which pictures a page has room for, how finely, and that they come back from it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig
from pdcd.pages.report import layers
from pdcd.panels.map import Map
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.upright import FieldView
from tests.unit.pages.report._blocks import unpacked


def pictures(count: int, frame: tuple[int, int] = (4, 6)) -> dict[str, PictureWithErrors]:
    rng = np.random.default_rng(4)
    made = {}
    for n in range(count):
        error = np.full((*frame, 3), 0.5, np.float32)
        image = 100.0 + 10.0 * n + rng.random((*frame, 3))
        made[f"p{n}"] = PictureWithErrors(image, error, error, 0.0 * error, "sensor")
    return made


@pytest.mark.parametrize(
    ("count", "white", "kept", "left"),
    [
        (2, None, ["p0", "p1"], ()),
        (8, 7, ["p0", "p1", "p2", "p3", "p4", "p5", "p6", "white"], ()),
        (9, 2, ["p0", "p1", "white", "p3", "p4", "p5", "p6", "p7"], ("p8",)),
        (10, 9, ["p0", "p1", "p2", "p3", "p4", "p5", "p6", "white"], ("p7", "p8")),
    ],
)
def test_the_white_picture_has_room_before_others(
    count: int, white: int | None, kept: list[str], left: tuple[str, ...]
) -> None:
    made = pictures(count)
    named = {("white" if name == f"p{white}" else name): one for name, one in made.items()}
    shown = layers.pack_layers(named, FieldView(Map.filling((6, 4)), 1.5), None, side=2)
    assert [one["name"] for one in shown.data] == kept and shown.left_out == left
    assert shown.size_px == (6, 4) and shown.quads == 4.0
    assert all(one["kind"] == "picture" and one["sigma"] is not None for one in shown.data)


def test_pictures_and_their_truth_come_back_from_a_page() -> None:
    made = pictures(2)
    made["p1"].image[1, 2] = np.nan
    truth = layers.AnswerTruth(made["p0"].image + 1.0, np.ones((4, 6), np.bool_))
    truth.seen[3, 0] = False
    shown = layers.pack_layers(made, FieldView(Map.filling((6, 4)), 1.5), truth)
    assert [(one["name"], one["kind"]) for one in shown.data] == [
        ("p0", "picture"), ("p1", "picture"), ("p0", "truth"),
    ]  # fmt: skip
    for one, wanted in zip(
        shown.data, (made["p0"].image, made["p1"].image, truth.image), strict=True
    ):
        back = np.moveaxis(unpacked(one["values"]), 0, -1)
        known = np.isfinite(back)
        lost = {(1, 2)} if one["name"] == "p1" else {(3, 0)} if one["kind"] == "truth" else set()
        assert {tuple(p) for p in np.argwhere(~known.all(axis=-1)).tolist()} == lost
        # A step is half of the usual sigma, and rounding is off by half of that.
        assert one["values"]["step"] == pytest.approx(0.25, rel=1e-3)
        assert np.abs(back - wanted)[known].max() <= 0.126
    assert shown.data[2]["sigma"] is None
    sigma = np.moveaxis(unpacked(shown.data[1]["sigma"]), 0, -1)
    assert np.isinf(sigma[1, 2]).all() and np.allclose(sigma[0], 0.5, rtol=0.0101)


def test_large_pictures_have_every_second_sigma(monkeypatch: pytest.MonkeyPatch) -> None:
    for most, shape in ((24, [3, 4, 6]), (23, [3, 2, 3])):
        monkeypatch.setattr(layers, "LARGE_PX", most)
        shown = layers.pack_layers(pictures(1), FieldView(Map.filling((6, 4)), 1.5), None)
        assert shown.data[0]["sigma"]["shape"] == shape


def test_room_for_pixels_is_shared_between_pictures_and_a_truth() -> None:
    view = FieldView(Map.filling((4000, 3000)), 4.0 / 3.0)
    for count in (3, 8):
        width, height = layers.choose_layer_size(count, view)
        assert width * height * (count + 1) == pytest.approx(layers.MOST_PIXELS, rel=0.01)
    assert layers.choose_layer_size(9, view) == layers.choose_layer_size(8, view)
    assert layers.choose_layer_size(1, FieldView(Map.filling((400, 300)), 4.0 / 3.0)) == (400, 300)


def test_squares_of_quads_are_nearly_as_wide_as_a_pixel_of_the_page() -> None:
    """4000 quads on 677 pixels: 5.9 to a pixel."""
    cells = SimpleNamespace(
        frame=(3000, 4000), filled=Map.filling((4000, 3000)), can_bin=lambda side: side != 6
    )
    any_side = SimpleNamespace(**(vars(cells) | {"can_bin": lambda side: True}))
    told: dict[str, Any] = {
        "projector": PanelConfig(size_px=(1024, 768)), "white_patch": None,
    }  # fmt: skip
    for found, side in (({"cells": cells}, 5), ({"cells": any_side}, 6), ({"cells": None}, 1)):
        record: Any = SimpleNamespace(**(told | found))
        assert layers.choose_bin_side(8, record) == side
