"""Pictures of a page: how large they get, what their sigma means when they were shrunk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, PanelConfig
from pdcd.pages.report import layers
from pdcd.pages.report.layers import AnswerTruth
from pdcd.pages.report.packing import block_size_bytes
from pdcd.pages.report.write import write_report
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.truth import read_known_answer
from pdcd.pictures.upright import FieldSampler, FieldView
from pdcd.verdict.error_budget import make_error_budget
from tests import bench_rig
from tests.taken import take

LARGE = 1424, 2136
"""Quads of a body of 4272 x 2848 samples."""
MOST_BYTES = 12_000_000


def noisy(frame: tuple[int, int], seed: int, code: float = 0.0) -> PictureWithErrors:
    """Shot noise over a bright gradient: where it is bright, far above the usual step."""
    rng = np.random.default_rng(seed)
    light = np.linspace(0.01, 1.0, frame[1])[None, :, None] ** 2 * np.ones((*frame, 3))
    sensor = (0.01 * np.sqrt(light)).astype(np.float32)
    image = light + sensor * rng.standard_normal(light.shape)
    error = np.full(light.shape, code, np.float32)
    return PictureWithErrors(image, np.hypot(sensor, error), sensor, error, "sensor")


@pytest.mark.long
@pytest.mark.parametrize("count", [3, 8])
def test_a_page_of_a_large_run_stays_below_twelve_megabytes(count: int) -> None:
    names = ["white", *map(str, range(1, count))]
    pictures = {name: noisy(LARGE, seed) for seed, name in enumerate(names)}
    truth = layers.AnswerTruth(pictures["white"].image, np.ones(LARGE, np.bool_))
    made = layers.pack_layers(pictures, FieldView(Map.filling(LARGE[::-1]), 1.5), truth)
    total = sum(
        block_size_bytes(one[part])
        for one in made.data
        for part in ("values", "sigma")
        if one[part]
    )
    assert total < 0.95 * MOST_BYTES and len(made.data) == count + 1


def test_sigma_of_a_shrunk_picture_is_that_of_the_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of the sensor averages out, the error of the codes does not."""
    monkeypatch.setattr(layers, "MOST_REPORT_PX", 30)
    shown: dict[str, NDArray[np.floating]] = {}
    monkeypatch.setattr(
        layers, "pack_logarithmic", lambda values: shown.setdefault("sigma", values) is None
    )
    picture = noisy((80, 120), 0, code=0.004)
    made = layers.pack_layers({"white": picture}, FieldView(Map.filling((120, 80)), 1.5), None)
    assert made.size_px == (30, 20) and made.quads == 16.0
    sensor = picture.sensor.reshape(20, 4, 30, 4, 3)
    wanted = np.hypot(np.sqrt((sensor**2).mean(axis=(1, 3)) / 16.0), 0.004)
    np.testing.assert_allclose(shown["sigma"], np.moveaxis(wanted, -1, 0), rtol=0.15)


@pytest.mark.parametrize(("frame", "squares"), [((138, 105), 3), ((128, 94), 2)])
def test_a_page_of_squares_of_quads_shows_what_one_of_all_quads_does(
    frame: tuple[int, int], squares: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A turned camera with some three quads to a pixel of the page, each way."""
    monkeypatch.setattr(layers, "MOST_REPORT_PX", 40)
    camera = CameraConfig(frame_quads=frame, place=Placing(turn_deg=6.0, scale=1.1))
    panel = PanelConfig(size_px=(128, 96))
    config = bench_rig.config(tmp_path, camera=camera, projector=panel, mask=panel)
    made = take(config, codes=16, parts=4)
    folder, record = made.folder, made.manifest.run
    side = layers.choose_bin_side(3, record)
    assert side == squares
    rooms = Darkroom(folder, record), Darkroom(folder, record)
    rooms[1].coarsen(side)
    fine, coarse = (room.decoded() for room in rooms)
    known = read_known_answer(folder, fine.cells)
    pages = [
        (
            layers.pack_layers(
                d.pictures, d.view, AnswerTruth(*known.binned(d.side).on_quads(d.cells)), d.side
            )
        )
        for d in (fine, coarse)
    ]
    assert pages[0].size_px == pages[1].size_px
    assert pages[0].quads == pytest.approx(pages[1].quads)
    seen = [
        layers._sampled(d.pictures, FieldSampler(d.view, pages[0].size_px), p.quads / d.side**2)
        for d, p in zip((fine, coarse), pages, strict=True)
    ]
    for name, one in seen[0].items():
        other = seen[1][name]
        both = one.known & other.known
        assert both.sum() > 0.9 * one.known.sum()
        off = (one.image - other.image)[both]
        assert np.sqrt(np.mean(off**2)) < 0.05 * np.sqrt(np.mean(one.image[both] ** 2))
        assert abs(off.mean()) < 2e-3 * one.image[both].mean()
        # Where it is dark, samples below black widen the error bars of single quads a little.
        assert np.median(other.sigma[both] / one.sigma[both]) == pytest.approx(1.0, abs=0.1)
    rows = [{row.name: row.share for row in make_error_budget(record, d)} for d in (fine, coarse)]
    assert rows[1]["noise"] == pytest.approx(rows[0]["noise"], rel=0.1)
    assert rows[1]["all"] == pytest.approx(rows[0]["all"], rel=0.15)
    assert write_report(folder).stat().st_size > 10_000
