"""What is wrong with a photo is told by its own name, at the edges of what is borne."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.calibration.photo import (
    Photo,
    Seen,
    block_means,
    blocks_of,
    refuse_clipped,
    refuse_dark,
    refuse_moving_black,
    refuse_settings,
    steady,
)
from pdcd.errors import CalibrationError

LIGHT = np.arange(4.0 * 6.0 * 3.0).reshape(4, 6, 3)


def test_a_photo_has_three_colours_and_one_shape() -> None:
    whole = Photo(LIGHT, LIGHT, np.zeros((4, 6), np.bool_))
    assert whole.frame == (4, 6)
    for light in (LIGHT[..., 0], LIGHT[..., :2]):
        with pytest.raises(ValueError, match=r"a photo is \(h, w, 3\)"):
            Photo(light, light)
    with pytest.raises(ValueError, match="light and variance"):
        Photo(LIGHT, LIGHT[:3])
    with pytest.raises(ValueError, match="saturated quads differ"):
        Photo(LIGHT, LIGHT, np.zeros((6, 4), np.bool_))


def test_the_share_of_saturated_quads_is_of_those_asked_for() -> None:
    saturated = np.zeros((4, 6), np.bool_)
    saturated[0, :3] = True
    photo = Photo(LIGHT, LIGHT, saturated)
    assert photo.saturated_share() == 3 / 24
    where = np.zeros((4, 6), np.bool_)
    assert photo.saturated_share(where) == 0.0
    where[0] = True
    assert photo.saturated_share(where) == 0.5
    assert Photo(LIGHT, LIGHT).saturated_share() == 0.0


def test_blocks_are_means_and_a_rest_is_left_out() -> None:
    found = block_means(LIGHT, 2)
    assert found.shape == (2, 3, 3)
    np.testing.assert_allclose(found[1, 2], LIGHT[2:4, 4:6].mean(axis=(0, 1)))
    assert block_means(LIGHT, 3).shape == (1, 2, 3)
    np.testing.assert_allclose(block_means(LIGHT[..., 0], 4), [[LIGHT[:4, :4, 0].mean()]])
    for values in (LIGHT[:3], LIGHT[:, :3]):
        with pytest.raises(CalibrationError, match="is too small") as caught:
            block_means(values, 4)
        assert caught.value.device == "camera" and "at least 4 x 4" in str(caught.value.hint)
    assert block_means(np.ones((16, 32))).shape == (1, 2)
    saturated = np.zeros((4, 6), np.bool_)
    saturated[0, :3] = True
    blocks = blocks_of(Photo(LIGHT, LIGHT, saturated), 2)
    np.testing.assert_allclose(blocks.mean, found)
    np.testing.assert_allclose(blocks.variance, found / 4.0)
    assert blocks.clipped.tolist() == [[0.5, 0.25, 0.0], [0.0, 0.0, 0.0]]
    assert not blocks_of(Photo(LIGHT, LIGHT), 2).clipped.any()


def test_more_than_a_thousandth_of_saturated_quads_is_refused() -> None:
    saturated = np.zeros((50, 40), np.bool_)
    light = np.ones((50, 40, 3))
    saturated[0, :2] = True
    refuse_clipped("white", Photo(light, light, saturated), "close it")
    saturated[0, :3] = True
    photo = Photo(light, light, saturated)
    for given in (photo, blocks_of(photo, 10)):
        with pytest.raises(CalibrationError, match=r"photo white is saturated in 0\.15 %") as found:
            refuse_clipped("white", given, "close it")
        assert (found.value.device, found.value.hint) == ("camera", "close it")
    refuse_clipped("white", Photo(light, light), "close it")


def test_dark_photos_are_the_lamp_s_or_the_shutter_s() -> None:
    refuse_dark({"a": 1.1, "b": 2.0}, 1.0)
    refuse_dark({}, 1.0)
    with pytest.raises(CalibrationError, match="no photo shows any light") as caught:
        refuse_dark({"a": 1.0, "b": 0.5}, 1.0)
    assert caught.value.device == "camera" and "lens cap" in str(caught.value.hint)
    with pytest.raises(CalibrationError, match="photo a is dark, others") as caught:
        refuse_dark({"c": 2.0, "b": 0.5, "a": 0.9}, 1.0)
    assert caught.value.device == "shutter" and "cable" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (Seen(), ""),
        (Seen(iso=100, exposure_s=2.0, f_number=8.0), ""),
        (Seen(iso=200), "photo a was taken at ISO 200, not at ISO 100"),
        (Seen(f_number=8.47), ""),
        (Seen(f_number=8.5), "photo a was taken at f/8.5, not at f/8"),
        (Seen(f_number=7.5), "photo a was taken at f/7.5, not at f/8"),
        (Seen(exposure_s=1.0), ""),
        (Seen(exposure_s=0.9), "photo a was exposed for 0.9 s, not for 2.5 s"),
        (Seen(exposure_s=9.0), ""),
    ],
)
def test_a_camera_that_was_set_otherwise_is_told(said: Seen, words: str) -> None:
    asked: dict[str, Any] = {"iso": 100, "f_number": 8.0, "open_s": {"a": 2.5}}
    if not words:
        refuse_settings({"a": said}, **asked)
        return
    with pytest.raises(CalibrationError) as caught:
        refuse_settings({"a": said}, **asked)
    assert words in str(caught.value) and caught.value.hint
    assert caught.value.device == ("shutter" if "exposed" in words else "camera")


def test_a_lens_that_is_not_set_from_here_must_stay_as_it_is() -> None:
    refuse_settings({"a": Seen(f_number=5.6), "b": Seen(f_number=5.6), "c": Seen()}, iso=100)
    refuse_settings({"a": Seen(exposure_s=1.0)}, iso=100)
    refuse_settings({"a": Seen(exposure_s=1.0)}, iso=100, open_s={"b": 9.0})
    with pytest.raises(CalibrationError, match=r"aperture changed .* f/5\.6 to f/8") as caught:
        refuse_settings({"a": Seen(f_number=8.0), "b": Seen(f_number=5.6)}, iso=100)
    assert caught.value.device == "camera" and "manual" in str(caught.value.hint)


def test_a_black_level_that_moves_is_refused() -> None:
    still = {"a": Seen(black_dn=(1024.0, 1020.0)), "b": Seen(black_dn=(1025.5, 1020.0))}
    refuse_moving_black(still)
    refuse_moving_black({"a": Seen(), "b": Seen(black_dn=(1.0, 1.0)), "c": Seen()})
    refuse_moving_black({})
    for second in ((1025.6, 1020.0), (1024.0, 1018.4)):
        moving = {"a": Seen(black_dn=(1024.0, 1020.0)), "b": Seen(black_dn=second)}
        with pytest.raises(CalibrationError, match=r"black level moves by 1\.6 DN") as caught:
            refuse_settings(moving, iso=100)
        assert caught.value.device == "camera" and "warm up" in str(caught.value.hint)


def test_outliers_are_those_beyond_five_robust_deviations() -> None:
    """Deviations of 1 about 10: the median of these is 1, a deviation 1.4826."""
    values = [9.0, 11.0, 9.0, 11.0, 10.0 + 7.4, 10.0 - 7.5]
    assert steady(values).tolist() == [True] * 5 + [False]
    assert steady([5.0, 5.0, 5.0]).all() and steady([5.0, 5.0, 5.0, 5.1]).tolist()[-1] is False
    assert steady(np.array([1e9, 1e9, 1e9 + 1e-4])).all()  # rounding is no outlier
