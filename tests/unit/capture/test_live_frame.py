"""Figures of a picture of a live view, against pictures whose figures are known."""

from __future__ import annotations

import cv2
import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.capture.live_frame import LiveFrames, find_field_outline, measure_detail
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from pdcd.sensor.finder_picture import draw_finder_picture, read_finder_light


def placed(**given: object) -> Config:
    config = Config()
    camera = msgspec.structs.replace(config.camera, place=Placing(**given))  # type: ignore[arg-type]
    return msgspec.structs.replace(config, camera=camera)


def test_stripes_are_as_deep_as_they_are_made_and_less_so_out_of_focus() -> None:
    """A sine of period 4 px and depth 0.5 loses what a Gaussian of 2 px leaves of it: 0.7 %."""
    x = np.arange(240)
    wave = 0.4 * (1.0 + 0.5 * np.sin(np.pi * x / 2))
    light = np.tile(wave, (160, 1)).astype(np.float32)
    everywhere = np.ones(light.shape, np.uint8)
    kept = 1.0 - np.exp(-0.5 * (2.0 * np.pi * 2.0 / 4.0) ** 2)
    found = measure_detail(light, everywhere)
    assert found == pytest.approx(0.5 * kept, rel=0.01)
    depths = [found]
    for sigma in (0.5, 1.0, 2.0):
        blurred = np.asarray(cv2.GaussianBlur(light, (0, 0), sigma), np.float32)
        depths.append(measure_detail(blurred, everywhere))
    assert depths == sorted(depths, reverse=True) and depths[-1] < 0.1 * found


def test_levels_lead_to_light_and_back() -> None:
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    light = read_finder_light(levels)
    assert light[0, 0] == 0.0 and light[-1, -1] == 1.0
    assert light.ravel()[128] == pytest.approx(0.2158605, abs=1e-6)  # IEC 61966-2-1
    drawn = draw_finder_picture(light.astype(np.float64)).astype(int)
    assert np.abs(drawn - levels).max() <= 1
    assert draw_finder_picture(np.array([np.nan, -1.0, 2.0])).tolist() == [0, 0, 255]


def test_the_outline_is_where_the_camera_lies() -> None:
    # Twice as large as the field, so that this is the middle half of the picture.
    outline = np.array(find_field_outline(placed(scale=2.0), (200, 100)))
    assert np.allclose([outline.min(axis=0), outline.max(axis=0)], [[0.25, 0.25], [0.75, 0.75]])
    whole = find_field_outline(placed(map=Map.filling((40, 30))), None)
    assert np.allclose([np.min(whole, axis=0), np.max(whole, axis=0)], [[0, 0], [1, 1]])
    assert find_field_outline(Config(), (200, 100)) == ()
    assert find_field_outline(placed(scale=2.0), None) == ()


def test_figures_are_those_of_the_field() -> None:
    picture = np.full((100, 200, 3), 188, np.uint8)
    picture[:, :100] = 255  # what is saturated beside the field does not count
    frames = LiveFrames(placed(scale=4.0, offset_px=(-768.0, 0.0)), (200, 100))
    beside = frames.make(picture, 1)
    assert beside.saturated == 0.0 and beside.mean == pytest.approx(0.503, abs=0.001)
    everywhere = LiveFrames(Config(), (200, 100)).make(picture, 1)
    assert everywhere.saturated == 0.5


def test_large_pictures_are_made_small() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (900, 1600), np.uint8)
    frame = LiveFrames(Config(), None).make(noise, 1)
    assert frame.size_px == (800, 450) and len(frame.jpeg) < 2**19


def test_rates_are_told_by_the_times_of_pictures() -> None:
    frames, picture = LiveFrames(Config(), None), np.zeros((3, 4, 3), np.uint8)
    told = [frames.make(picture, round(number * 1e9 / 15)) for number in range(60)]
    assert told[0].rate_hz == 0.0 and told[-1].rate_hz == pytest.approx(15.0)
