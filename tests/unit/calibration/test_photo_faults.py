"""What is wrong with a photo is told by its own name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.calibration.photo import (
    QuadPhoto,
    RawSettings,
    average_blocks,
    average_photo_blocks,
    check_brightness,
    check_camera_settings,
    find_inliers,
)
from pdcd.errors import CalibrationError

LIGHT = np.arange(4.0 * 6.0 * 3.0).reshape(4, 6, 3)


def test_blocks_are_means_and_a_rest_is_left_out() -> None:
    found = average_blocks(LIGHT, 2)
    assert found.shape == (2, 3, 3)
    np.testing.assert_allclose(found[1, 2], LIGHT[2:4, 4:6].mean(axis=(0, 1)))
    np.testing.assert_allclose(average_blocks(LIGHT[..., 0], 4), [[LIGHT[:4, :4, 0].mean()]])
    with pytest.raises(CalibrationError, match="is too small") as caught:
        average_blocks(LIGHT[:, :3], 4)
    assert caught.value.device == "camera" and "at least 4 x 4" in str(caught.value.hint)
    saturated = np.zeros((4, 6), np.bool_)
    saturated[0, :3] = True
    blocks = average_photo_blocks(QuadPhoto(LIGHT, LIGHT, saturated), 2)
    np.testing.assert_allclose(blocks.mean, found)
    np.testing.assert_allclose(blocks.variance, found / 4.0)
    assert blocks.clipped.tolist() == [[0.5, 0.25, 0.0], [0.0, 0.0, 0.0]]
    assert not average_photo_blocks(QuadPhoto(LIGHT, LIGHT), 2).clipped.any()


def test_dark_photos_are_the_lamp_s_or_the_shutter_s() -> None:
    check_brightness({"a": 1.1, "b": 2.0}, 1.0)
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
        (RawSettings(f_number=8.1), ""),
        (RawSettings(f_number=9.0), "photo a was taken at f/9, not at f/8"),
        (RawSettings(exposure_s=0.5), "photo a was exposed for 0.5 s, not for 2.5 s"),
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
    with pytest.raises(CalibrationError, match=r"aperture changed .* f/5\.6 to f/8") as caught:
        check_camera_settings(
            {"a": RawSettings(f_number=8.0), "b": RawSettings(f_number=5.6)}, iso=100
        )
    assert caught.value.device == "camera" and "manual" in str(caught.value.hint)


def test_a_black_level_that_moves_is_refused() -> None:
    seen = {"a": RawSettings(), "b": RawSettings(black_dn=(1024.0, 1020.0))}
    check_camera_settings(seen | {"c": RawSettings(black_dn=(1025.0, 1020.0))}, iso=100)
    moving = seen | {"c": RawSettings(black_dn=(1024.0, 1017.0))}
    with pytest.raises(CalibrationError, match=r"black level moves by 3 DN") as caught:
        check_camera_settings(moving, iso=100)
    assert caught.value.device == "camera" and "warm up" in str(caught.value.hint)


def test_outliers_are_those_beyond_five_robust_deviations() -> None:
    """Deviations of 1 about 10: the median of these is 1, a deviation 1.4826."""
    values = [9.0, 11.0, 9.0, 11.0, 10.0 + 7.4, 10.0 - 7.5]
    assert find_inliers(values).tolist() == [True] * 5 + [False]
    assert find_inliers([5.0, 5.0, 5.0, 5.1]).tolist() == [True] * 3 + [False]
    assert find_inliers(np.array([1e9, 1e9, 1e9 + 1e-4])).all()  # rounding is no outlier
