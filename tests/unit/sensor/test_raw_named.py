"""Borders that are not dark, and forms that cannot be read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rawpy

from pdcd.errors import DecodeError
from pdcd.sensor import mosaic
from pdcd.sensor.raw import read_raw, read_raw_head
from tests.form_dng import BYTE, LONG, SHORT, DngFile, Tag, write_dng_form

SHAPE = 128, 192
RNG = np.random.default_rng(7)
NOISE = RNG.normal(1500.0, 30.0, SHAPE).round().astype(np.uint16)
PLAIN = DngFile()

# Masked borders.

LIT = NOISE.copy()
LIT[:, :16] = RNG.normal(260.0, 4.0, (SHAPE[0], 16)).round()
DARK = 0, 0, 128, 16


@pytest.mark.parametrize(
    ("areas", "border", "black", "words"),
    [
        (DARK, 260.0, 260.0, None),
        (DARK, 300.0, 300.0, "the border is believed"),  # 1.1 % of the way to white
        ((0, 16, 128, 40), 260.0, 256.0, "lie in the picture"),
        ((0, 8, 128, 20), 260.0, 256.0, "lie in the picture"),
        ((0, 0, 300, 16), 260.0, 256.0, "lie beyond the file"),
        ((0, 9, 128, 2), 260.0, 256.0, "lie beyond the file"),
        ((0, 0, 128), 260.0, 256.0, "are not four numbers"),
        (DARK, 2100.0, 256.0, "as bright as the picture"),
        (DARK, 700.0, 256.0, "is not dark"),
        (DARK, 40.0, 256.0, "is not dark"),
        ((*DARK, 0, 20, 100, 40), 260.0, 260.0, "lie in the picture"),
    ],
)
def test_only_dark_borders_are_believed(
    tmp_path: Path, areas: Sequence[int], border: float, black: float, words: str | None
) -> None:
    image = LIT.copy()
    image[:, :16] = image[:, :16].astype(int) + round(border - 260.0)
    file = replace(PLAIN, active=(0, 16, *SHAPE), masked=areas)
    write_dng_form(tmp_path / "a.dng", image, file)
    frame = read_raw(tmp_path / "a.dng")
    np.testing.assert_allclose(frame.black, black, atol=0.5)
    assert frame.masked is (black != 256.0)
    assert (words in " ".join(frame.doubts)) if words else frame.doubts == ()
    assert frame.exif().get("doubts", []) == list(frame.doubts)


@pytest.mark.parametrize(("border", "black"), [(600.0, 600.0), (1100.0, 0.0)])
def test_a_border_is_believed_up_to_a_quarter_of_white_where_no_tag_tells(
    tmp_path: Path, border: float, black: float
) -> None:
    image = LIT.copy()
    image[:, :16] = border
    file = replace(PLAIN, black=((0.0,),), active=(0, 16, *SHAPE), masked=DARK)
    write_dng_form(tmp_path / "a.dng", image, file)
    assert read_raw(tmp_path / "a.dng").black.tolist() == [black] * 4


def test_a_border_with_a_picture_on_it_is_not_dark(tmp_path: Path) -> None:
    image = LIT.copy()
    image[:, :16] = RNG.integers(0, 520, (SHAPE[0], 16))  # 260 on average
    file = replace(PLAIN, active=(0, 16, *SHAPE), masked=DARK)
    write_dng_form(tmp_path / "a.dng", image, file)
    frame = read_raw(tmp_path / "a.dng")
    assert not frame.masked and "not dark" in frame.doubts[0]


# Forms that are named.


@pytest.mark.parametrize("read", [read_raw, read_raw_head])
@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({259: (SHORT, [9])}, "packed with VC-5"),
        ({259: (SHORT, [52546])}, "packed with JPEG XL"),
        ({259: (SHORT, [34892])}, "packed with lossy JPEG"),
        ({259: (SHORT, [8])}, "16-bit samples of format 1, packed in the way 8.1"),
        ({262: (SHORT, [34892]), 277: (SHORT, [3])}, "a linear DNG"),
        ({33421: (SHORT, [6, 6]), 33422: (BYTE, [1, 0, 2, 1, 2, 0] * 6)}, "an X-Trans sensor"),
        ({33421: (SHORT, [4, 4]), 33422: (BYTE, [0, 0, 1, 1] * 2 + [1, 1, 2, 2] * 2)},
         "of a quad Bayer sensor"),
        ({33422: (BYTE, [1, 6, 3, 0])}, "of a mosaic of 2 x 2 places, GWCR"),
        ({50711: (SHORT, [2])}, "in staggered rows"),
        ({50974: (SHORT, [2, 2])}, "packed with its rows, columns or blocks in another order"),
        ({50975: (SHORT, [2])}, "packed with its rows, columns or blocks in another order"),
        ({52547: (LONG, [2])}, "packed with its rows, columns or blocks in another order"),
        ({258: (SHORT, [32])}, "32-bit samples of format 1"),
        ({259: (SHORT, [7]), 278: (LONG, [64]), 273: (LONG, [8] * 2), 279: (LONG, [9] * 2)},
         "packed with lossless JPEG in several strips"),
    ],
)  # fmt: skip
def test_whole_files_are_called_what_they_are(
    tmp_path: Path, read: Any, more: dict[int, Tag], words: str
) -> None:
    write_dng_form(tmp_path / "a.dng", NOISE, replace(PLAIN, more=more))
    with pytest.raises(DecodeError, match=words) as caught:
        read(tmp_path / "a.dng")
    assert caught.value.hint and "fetch it" not in caught.value.hint


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"raw_type": rawpy.RawType.Stack}, "a reduced-size or ready-made picture"),
        ({"raw_pattern": np.arange(36).reshape(6, 6) % 3}, "of an X-Trans sensor"),
        ({"raw_pattern": np.arange(16).reshape(4, 4) % 3}, "of a mosaic of 4 x 4 places, RGB"),
    ],
)
def test_what_libraw_finds_is_called_what_it_is(said: dict[str, Any], words: str) -> None:
    sizes = SimpleNamespace(top_margin=0, left_margin=0)
    form = {"raw_type": rawpy.RawType.Flat, "color_desc": b"RGBG", "sizes": sizes, "num_colors": 3}
    form |= said
    raw: Any = SimpleNamespace(name="a.raf", libraw=SimpleNamespace(**form, raw_image=NOISE))
    with pytest.raises(DecodeError, match=f"cannot decode a.raf: it is {words}") as caught:
        mosaic._of_libraw(raw, mosaic._unpack(raw))
    assert caught.value.hint and "fetch it" not in caught.value.hint


def test_samples_that_are_no_numbers(tmp_path: Path) -> None:
    real = NOISE.astype(np.float64) / 4096.0
    real[3, 4] = np.nan
    data = write_dng_form(
        tmp_path / "a.dng", real, replace(PLAIN, floating=True, white=1, black=((0.0,),))
    )
    assert data
    with pytest.raises(DecodeError, match="some samples are no numbers"):
        read_raw(tmp_path / "a.dng")
