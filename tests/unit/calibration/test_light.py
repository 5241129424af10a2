"""Contrasts, room light and brightness of benches whose numbers are known."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import PanelConfig
from pdcd.calibration.figures import Verdict
from pdcd.calibration.light.contrasts import LightMeasurement, compute_responsivity, measure_light
from pdcd.calibration.light.light_plan import COVERED, LightPlan, PulseEdges
from pdcd.calibration.photo import QuadPhoto, average_photo_blocks
from pdcd.calibration.shown import PanelSequence, pack_frames
from pdcd.errors import CalibrationError
from pdcd.probing.realised import collect_factors, compute_bench_factors
from tests.frame_logs import make_log
from tests.unit.calibration.light_bench import LightBench, TruePanel

Floats = NDArray[np.float64]

PLAN = LightPlan(refreshes=60)
EDGES = PulseEdges(0.002, 0.002, 0.001)
"""What the panels of LightBench add: fall 4 ms, rise 2 ms."""
ALBEDO, WHITE_E = 0.9, 20000.0


@cache
def seconds(leak_p: float, leak_m: float, name: str) -> tuple[float, float]:
    bench = LightBench(TruePanel(leak_p), TruePanel(leak_m))
    shown = next(shown for shown in PLAN.photos() if shown.name == name)
    return bench.seconds(shown, name in COVERED)


def series(
    seed: int = 0,
    projector: float = 2000.0,
    mask: float = 500.0,
    room: float = 0.01,
    *,
    card: Floats | float = ALBEDO,
    black_error_dn: float = 0.1,
    lamp: Mapping[str, float] | None = None,
    rooms: Mapping[str, float] | None = None,
    shut: tuple[str, ...] = (),
    scale: float = 1.0,
    falloff: float = 0.3,
) -> dict[str, QuadPhoto]:
    """All photos; `room` in scene units. `lamp` and `rooms` are factors by name."""
    bench = LightBench(shape=(64, 80), falloff=falloff)
    rng = np.random.default_rng(seed)
    photos = {}
    for shown in PLAN.photos():
        lit_s, open_s = seconds(1.0 / projector, 1.0 / mask, shown.name)
        reflected = lit_s * (lamp or {}).get(shown.name, 1.0) * np.asarray(card)
        stray = open_s * room * (rooms or {}).get(shown.name, 1.0)
        light = scale * WHITE_E / ALBEDO * (reflected + stray) * bench.vignetting()
        light = light * (shown.name not in shut) * np.array([0.7, 1.0, 0.8])
        light = np.broadcast_to(light, (64, 80, 3)).copy()
        photos[shown.name] = bench.photo(light, rng, black_error_dn)
    return photos


def measured(
    photos: Mapping[str, QuadPhoto],
    black_sigma: float = 0.1,
    edges: PulseEdges = EDGES,
    field: NDArray[np.bool_] | None = None,
) -> LightMeasurement:
    blocks = {name: average_photo_blocks(photo) for name, photo in photos.items()}
    return measure_light(blocks, PLAN, edges=edges, black_sigma=black_sigma, field=field)


def test_finds_contrasts_and_room() -> None:
    light = measured(series(1, room=0.008))
    assert light.mask.contrast[0] == pytest.approx(500.0, rel=0.01)
    assert light.projector.contrast[0] == pytest.approx(2000.0, rel=0.03)
    ambient = light.ambient(ALBEDO)
    assert ambient is not None
    assert ambient[0] == pytest.approx(0.008, rel=0.01)
    assert np.nanmedian(light.mask_map) == pytest.approx(0.002, rel=0.01)
    assert max(f.verdict for f in light.figures()) == Verdict.GOOD


def test_errors_are_those_it_tells() -> None:
    pulls = []
    for seed in range(12):
        light = measured(series(100 + seed, black_error_dn=0.3), 0.3)
        assert light.room is not None
        for share, truth in (
            (light.mask, 1 / 500),
            (light.projector, 1 / 2000),
            (light.room, 0.01 / ALBEDO),
        ):
            pulls.append((share.value - truth) / share.sigma)
    assert 0.6 < float(np.std(pulls)) < 1.4
    assert abs(float(np.mean(pulls))) < 0.6


def test_brightness_of_a_unit() -> None:
    light = measured(series(2))
    value, sigma = compute_responsivity(
        light, gain_e_per_dn=(2.96, 0.005), f_number=8.0, albedo=ALBEDO, albedo_sigma=0.01
    )
    truth = WHITE_E / ALBEDO * 64.0 * np.array([0.7, 1.0, 0.8])
    assert value == pytest.approx(truth, rel=0.005)
    assert sigma / value == pytest.approx(0.011, rel=0.2)  # the card's albedo is the worst of it
    with pytest.raises(CalibrationError, match="albedo of 88"):
        compute_responsivity(
            light, gain_e_per_dn=(2.96, 0.01), f_number=8.0, albedo=88.0, albedo_sigma=1.0
        )


def test_without_a_covered_photo_the_room_is_said_to_be_in_it() -> None:
    photos = {name: photo for name, photo in series(3).items() if name not in COVERED}
    light = measured(photos)
    assert light.room is None
    assert light.ambient(1.0) is None
    assert light.projector.value == pytest.approx(0.0005 + 0.01 / ALBEDO, rel=0.02)
    figure = light.figures()[0]
    assert figure.verdict >= Verdict.DOUBTFUL
    assert "room" in figure.limit


def test_a_black_that_cannot_be_seen_is_only_bounded() -> None:
    light = measured(series(4, mask=1e7, black_error_dn=0.3), 0.3)
    assert not light.mask.seen
    value, _ = light.mask.contrast
    assert 5000.0 < value < 1e6
    assert "at least" in light.figures()[1].limit


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        ({"scale": 0.0}, "lens cap"),
        ({"shut": ("WW-again",)}, "WW-again is dark.*shutter did not open"),
        ({"shut": ("C-again",), "room": 0.02}, "photo C-again is dark"),
        ({"scale": 3.0}, "WW is saturated"),
        ({"room": 0.4, "scale": 0.2}, "room lights are on"),
        ({"rooms": {"BW-again": 1.1, "C": 1.1}}, "room changed"),
        ({"rooms": {"C": 1.4, "C-again": 1.4}}, "projector covered there is more light"),
        ({"lamp": {"WW-again": 0.9}}, "lamp changed"),
        ({"scale": 0.002}, "too dim"),
        ({"mask": 2.0, "scale": 0.1}, "mask does not block"),
        ({"mask": 3.3}, "WB is saturated.*does not block"),
        ({"projector": 3.0, "scale": 0.2}, "its black is too bright"),
    ],
)
def test_bad_input_has_a_named_cause(bench: dict[str, object], words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        measured(series(6, **bench))  # type: ignore[arg-type]


def test_an_inverted_mask() -> None:
    photos = series(7, scale=0.1)
    swapped = {name: photos[name] for name in photos}
    for name in ("WW", "WW-again"):
        swapped[name], swapped[name.replace("WW", "WB")] = photos["WB"], photos["WW"]
    with pytest.raises(CalibrationError, match="inverted"):
        measured(swapped)


def test_half_of_the_field_is_covered() -> None:
    card = np.full((64, 80, 1), ALBEDO)
    card[:, 40:] = 0.0
    photos = series(8, card=card)
    with pytest.raises(CalibrationError, match="of the field gets no light"):
        measured(photos, 0.3, field=np.ones((64, 80), np.bool_))
    with pytest.raises(CalibrationError, match="% of the photo only"):
        card[16:] = 0.0
        card[:, 16:] = 0.0
        measured(series(8, card=card), 0.3)


def photo_by_realised(shown: PanelSequence, projector: PanelConfig, mask: PanelConfig) -> Floats:
    """Seconds of light and of an open mask, by the matrix that decoding believes in."""
    frames = pack_frames(shown)
    log = make_log(len(frames), start_ns=100_000_000)
    close = int(log.end_ns[0]) + 100_000_000
    found = collect_factors(
        compute_bench_factors(frames, log, projector, mask, open_ns=0, close_ns=close)
    )
    return np.array([found.coaxial[0], found.open_s[0]])


def test_words_mean_what_the_configuration_means() -> None:
    """`contrast` and `ambient` of a configuration come back out of photos that pdcd's own forward
    model makes of it."""
    projector = PanelConfig(size_px=(8, 8), contrast=800.0, rise_s=0.001, fall_s=0.004)
    mask = PanelConfig(size_px=(8, 8), contrast=300.0, rise_s=0.002, fall_s=0.008, skew_s=0.003)
    ambient, albedo, responsivity, f_number = 0.02, 0.6, 8.6e6, 16.0
    photos = {}
    for shown in PLAN.photos():
        lit_s, open_s = photo_by_realised(shown, projector, mask)
        seen = albedo * lit_s * (shown.name not in COVERED) + ambient * open_s
        dn = seen * responsivity / f_number**2 / 2.96
        flat = np.full((32, 32, 3), dn)
        photos[shown.name] = QuadPhoto(flat, np.ones_like(flat), np.zeros((32, 32), np.bool_))
    light = measured(photos, 1e-3, PulseEdges(0.003, 0.006, 1e-4))
    assert light.projector.contrast[0] == pytest.approx(800.0, rel=1e-3)
    assert light.mask.contrast[0] == pytest.approx(300.0, rel=1e-3)
    found = light.ambient(albedo)
    assert found is not None
    assert found[0] == pytest.approx(ambient, rel=1e-3)
    value, _ = compute_responsivity(
        light, gain_e_per_dn=(2.96, 0.0), f_number=f_number, albedo=albedo, albedo_sigma=0.0
    )
    assert value == pytest.approx(np.full(3, responsivity), rel=1e-3)


def test_plan_opens_the_mask_around_the_light() -> None:
    for shown in PLAN.photos():
        lit = np.flatnonzero(shown.projector_index == -2)
        if lit.size:
            assert (lit[0], shown.refreshes - 1 - lit[-1]) == (PLAN.lead, PLAN.lead)
        assert np.unique(shown.mask_index).size == 1
