"""Previews: balance, stated brightness, what is not known, and the strip below."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.errors import NoSpaceError
from pdcd.panels.map import Map
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.upright import FieldView
from pdcd.pictures.written import previews
from pdcd.pictures.written.picture_files import CAPTION_SHARES
from pdcd.pictures.written.previews import HATCH, Previews, write_previews
from tests.captions import caption_height

Floats = NDArray[np.float64]

FRAME = (48, 64)
VIEW = FieldView(Map.filling((64, 48)), 64 / 48)
CAST = np.array([0.85, 1.0, 1.2])


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the pixels, for speed."""
    monkeypatch.setattr(previews, "LEAST_PX", 320)


def picture(image: Floats, sigma: float = 1e-4) -> PictureWithErrors:
    error = np.full(image.shape, sigma)
    return PictureWithErrors(image, error, error, error, "sensor")


def flat(level: float) -> Floats:
    return np.full((*FRAME, 3), level)


def middle(drawn: NDArray[np.uint8]) -> list[int]:
    pixel: list[int] = drawn[
        (drawn.shape[0] - caption_height(drawn.shape[1])) // 2, drawn.shape[1] // 2
    ].tolist()
    return pixel


def test_a_preview_is_the_field_with_a_strip_below() -> None:
    drawn = Previews({"white": picture(flat(0.6))}, VIEW).drawn("white")
    assert drawn.shape == (240 + caption_height(320), 320, 3) and drawn.dtype == np.uint8
    wide = Previews({"white": picture(flat(0.6))}, FieldView(VIEW.map, 2.0)).drawn("white")
    assert wide.shape == (160 + caption_height(320), 320, 3)


@pytest.mark.parametrize(
    ("level", "factor", "shown"),
    [(0.6, 1, 0.9), (0.31, 1, 0.465), (0.29, 2, 0.87), (0.01, 32, 0.48), (1.3, 0.25, 0.4875)],
)
def test_dark_light_is_brightened_by_a_power_of_two(
    level: float, factor: float, shown: float
) -> None:
    made = Previews({"white": picture(flat(0.6)), "other": picture(flat(level))}, VIEW)
    assert made.factor("white") == 1.0 and middle(made.drawn("white")) == [243] * 3
    assert made.factor("other") == factor
    assert middle(made.drawn("other")) == [round(255 * shown ** (1 / 2.2))] * 3


def test_without_a_white_photo_the_brightest_picture_is_the_measure() -> None:
    made = Previews({"low": picture(flat(0.01)), "high": picture(flat(0.2))}, VIEW)
    assert (made.factor("low"), made.factor("high")) == (16.0, 1.0)
    assert made.balance.source == "camera"


def test_light_below_zero_is_darker_than_the_grey_of_none() -> None:
    halves = flat(0.4)
    halves[:, :32], halves[:12] = -0.15, 0.0
    made = Previews({"white": picture(flat(0.9)), "halves": picture(halves)}, VIEW)
    assert made.factor("halves") == 2.0
    drawn = made.drawn("halves")
    none, below, above = (drawn[at][0] for at in ((20, 100), (150, 60), (150, 260)))
    assert none == 128
    assert above == 128 + round(255 * 0.8 ** (1 / 2.2)) // 2
    assert below == 127 - round(255 * 0.3 ** (1 / 2.2)) // 2
    height, step, margin = (round(share * 320) for share in CAPTION_SHARES)
    assert drawn[240 + height // 3, 320 - margin - 3 * step + 4, 0] == 128  # the scale
    dark = Previews({"white": picture(flat(0.0)), "dark": picture(-flat(1.0))}, VIEW)
    assert middle(dark.drawn("dark"))[0] < 30


def test_paper_in_the_white_photo_makes_all_pictures_neutral() -> None:
    """One balance for all: what is coloured in the others stays so."""
    white = flat(0.02)
    white[10:30, 10:40] = 0.8 * CAST
    white[35:, 50:] = (0.9, 0.2, 0.1)  # brighter in one channel, but not white
    red = flat(0.1) * CAST * (3.0, 1.0, 1.0)
    made = Previews({"white": picture(white), "red": picture(red)}, VIEW)
    assert made.balance.source == "white photo"
    np.testing.assert_allclose(made.balance.factors, 1.0 / CAST, rtol=5e-3)
    pixel = made.drawn("white")[100, 125].tolist()
    assert max(pixel) - min(pixel) <= 1
    first, second, third = middle(made.drawn("red"))
    assert first > second + 50 and abs(second - third) <= 1


def test_a_patch_that_cannot_be_seen_is_told() -> None:
    lit = picture(flat(0.8))
    lit.sigma[10:40, 10:50] = np.inf
    made = Previews({"white": lit}, FieldView(VIEW.map, VIEW.aspect, (0.5, 0.5)))
    assert made.balance.source == "white photo"
    assert made.warnings == ("nothing can be seen of a white patch at 0.5 0.5",)


@pytest.mark.parametrize("value", [0.5, np.nan, np.inf, -np.inf])
def test_what_is_not_known_is_hatched(value: float) -> None:
    blind = picture(flat(0.5))
    blind.image[20:28, 30:40], blind.sigma[20:28, 30:40] = value, np.inf
    made = Previews({"white": blind}, VIEW)
    drawn = made.drawn("white")[:240]
    hole = drawn[103:137, 153:197]
    assert set(np.unique(hole).tolist()) == set(HATCH)
    assert (drawn[:95] == 243).all() and (drawn[145:] == 243).all()


def test_files_are_the_same_every_time(tmp_path: Path) -> None:
    image = np.random.default_rng(2).uniform(0.0, 1.0, (*FRAME, 3))
    pictures = {"white": picture(image), "indirect": picture(0.1 * image)}
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        assert write_previews(folder, pictures, VIEW) == ()
    for name in ("white.png", "indirect.png"):
        data = (tmp_path / "a" / name).read_bytes()
        assert data == (tmp_path / "b" / name).read_bytes()
        seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        made = Previews(pictures, VIEW).drawn(Path(name).stem)
        assert seen is not None and np.array_equal(seen[..., ::-1], made)


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    (tmp_path / "white.png").symlink_to("/dev/full")
    with pytest.raises(NoSpaceError):
        write_previews(tmp_path, {"white": picture(flat(0.5))}, VIEW)
