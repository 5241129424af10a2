"""Where a bench has its devices, at how many points it is looked at, and how light falls off."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, PanelConfig
from pdcd.bench.truth import BenchTruth, TrueCamera, TruePanel, TrueScene
from pdcd.errors import ConfigError
from pdcd.panels.placing import Placing
from pdcd.virtual.optics.setting import OpticalSetting, compute_falloff
from tests.unit.virtual.optics.test_bench import PX, config_of


def setting_of(
    frame: tuple[int, int] = (3, 4), truth: BenchTruth | None = None, **more: Any
) -> OpticalSetting:
    return OpticalSetting(config_of(**more), truth or BenchTruth(), frame)


def test_light_falls_by_the_square_of_the_radius() -> None:
    assert compute_falloff(0.0, (4, 2)) is None
    light = compute_falloff(0.5, (4, 2))
    assert light is not None and light.shape == (2, 4)
    # Corners of the device are at radius^2 = 4 + 1 from its centre, pixels at 0.5 or 1.5, and 0.5.
    rows = [1.0 - 0.5 * (x * x + 0.25) / 5.0 for x in (-1.5, -0.5, 0.5, 1.5)]
    np.testing.assert_allclose(light, [rows, rows], rtol=1e-14)
    tall = compute_falloff(0.2, (1, 3))
    assert tall is not None
    np.testing.assert_allclose(tall[:, 0], [1.0 - 0.2 / 2.5, 1.0, 1.0 - 0.2 / 2.5])


@pytest.mark.parametrize(
    ("frame", "samples"),
    [
        ((3, 4), 12),
        ((36, 48), 2),  # one pixel a quad, and two points all the same
        ((9, 16), 4),  # three across, four down
        ((18, 12), 4),
        ((10, 13), 4),  # 3.69 and 3.6
        ((1, 1), 32),
    ],
)
def test_a_quad_is_looked_at_as_often_as_it_has_pixels_of_the_mask(
    frame: tuple[int, int], samples: int
) -> None:
    assert setting_of(frame).samples == samples


def test_a_quad_on_its_side_counts_its_way_along_both_axes() -> None:
    """Turned by 45 degrees a step of a quad goes as far right as down."""
    camera = CameraConfig(place=Placing(turn_deg=45.0, scale=2.0))
    # Twice 48 / 40 pixels long: 2.4 / sqrt(2) each way, 3.39 together.
    assert setting_of((30, 40), camera=camera).samples == 4


def test_drawing_goes_by_what_is_believed_and_light_by_what_is_true() -> None:
    truth = BenchTruth(
        projector=TruePanel(place=Placing(flip="horizontal")),
        camera=TrueCamera(place=Placing(flip="vertical")),
    )
    setting = setting_of(truth=truth)
    corner = np.array([[0.0, 0.0]])
    np.testing.assert_allclose(setting.on_projector(corner), [[48.0, 0.0]])
    np.testing.assert_allclose(setting.drawn.projector.map.from_field(corner), [[0.0, 0.0]])
    np.testing.assert_allclose(setting.panels.projector.map.from_field(corner), [[48.0, 0.0]])
    np.testing.assert_allclose(setting.camera.from_field(corner), [[0.0, 3.0]])
    assert setting.true.projector.place == Placing(flip="horizontal")


@pytest.mark.parametrize("name", ["projector", "mask", "camera"])
def test_every_map_is_made_when_a_bench_is_checked(name: str) -> None:
    beside = Placing(offset_px=(500.0, 0.0))
    fine = setting_of()
    fine.check()
    table = getattr(fine.believed, name)
    wrong = setting_of(**{name: msgspec.structs.replace(table, place=beside)})
    with pytest.raises(ConfigError, match="beside the field") as caught:
        wrong.check()
    assert caught.value.device == name
    true: Any = TrueCamera(place=beside) if name == "camera" else TruePanel(place=beside)
    with pytest.raises(ConfigError, match="beside the field"):
        setting_of(truth=BenchTruth(**{name: true})).check()


def test_taps_are_those_of_a_round_gaussian() -> None:
    """In projector pixels; rows of them one after the other."""
    mask = PanelConfig(size_px=PX, blur_px=1.5)
    setting = setting_of(mask=mask, truth=BenchTruth(scene=TrueScene(blur_taps=3)))
    offsets = np.array([tap.offset for tap in setting.taps]) * PX
    shares = np.array([tap.share for tap in setting.taps])
    assert len(offsets) == 9 and shares.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(shares @ offsets**2, [2.25, 2.25])
    np.testing.assert_allclose(shares @ offsets.prod(axis=1), 0.0, atol=1e-15)
    assert (np.diff(offsets[:3, 0]) > 0.0).all() and np.ptp(offsets[:3, 1]) == 0.0
    assert len(setting_of(mask=mask).taps) == 25
