"""What is wrong with a photo is told by its own name, at the edges of what is borne."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.calibration.photo import (
    QuadPhoto,
    RawSettings,
    average_blocks,
    average_photo_blocks,
    check_black_level,
    check_brightness,
    check_camera_settings,
    check_clipping,
    find_inliers,
)
from pdcd.errors import CalibrationError

LIGHT = np.arange(4.0 * 6.0 * 3.0).reshape(4, 6, 3)


def test_the_share_of_saturated_quads_is_of_those_asked_for() -> None:
    saturated = np.zeros((4, 6), np.bool_)
    saturated[0, :3] = True
    photo = QuadPhoto(LIGHT, LIGHT, saturated)
    assert photo.saturated_share() == 3 / 24
    where = np.zeros((4, 6), np.bool_)
    assert photo.saturated_share(where) == 0.0
    where[0] = True
    assert photo.saturated_share(where) == 0.5
    assert QuadPhoto(LIGHT, LIGHT).saturated_share() == 0.0


def test_blocks_are_means_and_a_rest_is_left_out() -> None:
    found = average_blocks(LIGHT, 2)
    assert found.shape == (2, 3, 3)
    np.testing.assert_allclose(found[1, 2], LIGHT[2:4, 4:6].mean(axis=(0, 1)))
    assert average_blocks(LIGHT, 3).shape == (1, 2, 3)
    np.testing.assert_allclose(average_blocks(LIGHT[..., 0], 4), [[LIGHT[:4, :4, 0].mean()]])
    for values in (LIGHT[:3], LIGHT[:, :3]):
        with pytest.raises(CalibrationError, match="is too small") as caught:
            average_blocks(values, 4)
        assert caught.value.device == "camera" and "at least 4 x 4" in str(caught.value.hint)
    assert average_blocks(np.ones((16, 32))).shape == (1, 2)
    saturated = np.zeros((4, 6), np.bool_)
    saturated[0, :3] = True
    blocks = average_photo_blocks(QuadPhoto(LIGHT, LIGHT, saturated), 2)
    np.testing.assert_allclose(blocks.mean, found)
    np.testing.assert_allclose(blocks.variance, found / 4.0)
    assert blocks.clipped.tolist() == [[0.5, 0.25, 0.0], [0.0, 0.0, 0.0]]
    assert not average_photo_blocks(QuadPhoto(LIGHT, LIGHT), 2).clipped.any()


def test_more_than_a_thousandth_of_saturated_quads_is_refused() -> None:
    saturated = np.zeros((50, 40), np.bool_)
    light = np.ones((50, 40, 3))
    saturated[0, :2] = True
    check_clipping("white", QuadPhoto(light, light, saturated), "close it")
    saturated[0, :3] = True
    photo = QuadPhoto(light, light, saturated)
    for given in (photo, average_photo_blocks(photo, 10)):
        with pytest.raises(CalibrationError, match=r"photo white is saturated in 0\.15 %") as found:
            check_clipping("white", given, "close it")
        assert (found.value.device, found.value.hint) == ("camera", "close it")
    check_clipping("white", QuadPhoto(light, light), "close it")


def test_dark_photos_are_the_lamp_s_or_the_shutter_s() -> None:
    check_brightness({"a": 1.1, "b": 2.0}, 1.0)
    check_brightness({}, 1.0)
    with pytest.raises(CalibrationError, match="no photo shows any light") as caught:
        check_brightness({"a": 1.0, "b": 0.5}, 1.0)
    assert caught.value.device == "camera" and "lens cap" in str(caught.value.hint)
    with pytest.raises(CalibrationError, match="photo a is dark, but others") as caught:
        check_brightness({"c": 2.0, "b": 0.5, "a": 0.9}, 1.0)
    assert caught.value.device == "shutter" and "cable" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (RawSettings(), ""),
        (RawSettings(iso=100, exposure_s=2.0, f_number=8.0), ""),
        (RawSettings(iso=200), "photo a was taken at ISO 200, not at ISO 100"),
        (RawSettings(f_number=8.47), ""),
        (RawSettings(f_number=8.5), "photo a was taken at f/8.5, not at f/8"),
        (RawSettings(f_number=7.5), "photo a was taken at f/7.5, not at f/8"),
        (RawSettings(exposure_s=1.0), ""),
        (RawSettings(exposure_s=0.9), "photo a was exposed for 0.9 s, not for 2.5 s"),
        (RawSettings(exposure_s=9.0), ""),
    ],
)
def test_a_camera_that_was_set_otherwise_is_told(said: RawSettings, words: str) -> None:
    asked: dict[str, Any] = {"iso": 100, "f_number": 8.0, "open_s": {"a": 2.5}}
    if not words:
        check_camera_settings({"a": said}, **asked)
        return
    with pytest.raises(CalibrationError) as caught:
        check_camera_settings({"a": said}, **asked)
    assert words in str(caught.value) and caught.value.hint
    assert caught.value.device == ("shutter" if "exposed" in words else "camera")


def test_a_lens_that_is_not_set_from_here_must_stay_as_it_is() -> None:
    check_camera_settings(
        {"a": RawSettings(f_number=5.6), "b": RawSettings(f_number=5.6), "c": RawSettings()},
        iso=100,
    )
    check_camera_settings({"a": RawSettings(exposure_s=1.0)}, iso=100)
    check_camera_settings({"a": RawSettings(exposure_s=1.0)}, iso=100, open_s={"b": 9.0})
    with pytest.raises(CalibrationError, match=r"aperture changed .* f/5\.6 to f/8") as caught:
        check_camera_settings(
            {"a": RawSettings(f_number=8.0), "b": RawSettings(f_number=5.6)}, iso=100
        )
    assert caught.value.device == "camera" and "manual" in str(caught.value.hint)


def test_a_black_level_that_moves_is_refused() -> None:
    still = {
        "a": RawSettings(black_dn=(1024.0, 1020.0)),
        "b": RawSettings(black_dn=(1025.5, 1020.0)),
    }
    check_black_level(still)
    check_black_level(
        {"a": RawSettings(), "b": RawSettings(black_dn=(1.0, 1.0)), "c": RawSettings()}
    )
    check_black_level({})
    for second in ((1025.6, 1020.0), (1024.0, 1018.4)):
        moving = {"a": RawSettings(black_dn=(1024.0, 1020.0)), "b": RawSettings(black_dn=second)}
        with pytest.raises(CalibrationError, match=r"black level moves by 1\.6 DN") as caught:
            check_camera_settings(moving, iso=100)
        assert caught.value.device == "camera" and "warm up" in str(caught.value.hint)


def test_outliers_are_those_beyond_five_robust_deviations() -> None:
    """Deviations of 1 about 10: the median of these is 1, a deviation 1.4826."""
    values = [9.0, 11.0, 9.0, 11.0, 10.0 + 7.4, 10.0 - 7.5]
    assert find_inliers(values).tolist() == [True] * 5 + [False]
    assert (
        find_inliers([5.0, 5.0, 5.0]).all()
        and find_inliers([5.0, 5.0, 5.0, 5.1]).tolist()[-1] is False
    )
    assert find_inliers(np.array([1e9, 1e9, 1e9 + 1e-4])).all()  # rounding is no outlier
