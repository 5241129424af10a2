"""The step of light before a bench whose numbers are known: photos, words, figures, advice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, Literal

import msgspec
import numpy as np
import pytest

from pdcd.calibration.figures import Verdict
from pdcd.calibration.light.light_plan import COVERED
from pdcd.calibration.light.light_step import COVER, UNCOVER, calibrate_light
from pdcd.calibration.photo import QuadPhoto, RawSettings
from pdcd.calibration.script import PhotoRequest
from pdcd.calibration.sensor.sensor_step import BLACK_SIGMA_KEY, EDGE_KEY, GAIN_KEY
from pdcd.panels.frames import WHITE
from tests.unit.calibration.scripted import Answered, Run, preview_of, run, session_of
from tests.unit.planning.test_measured import config

SHAPE = (144, 192)
PANEL = (256, 192)
T = 1.0 / 60.0
FULL = 240
COLOURS = np.array([0.7, 1.0, 0.8])


def limited(level: np.ndarray) -> np.ndarray:
    """What a panel makes of levels that takes 16 for black and 235 for white."""
    return np.asarray(np.clip((255.0 * level - 16.0) / 219.0, 0.0, 1.0))


CURVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "linear": lambda x: x,
    "gamma 2.2": lambda x: x**2.2,
    "gamma 3": lambda x: x**3.0,
    "gamma 0.5": lambda x: x**0.5,
    "sRGB": lambda x: np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4),
    "limited": lambda x: limited(x) ** 2.2,
    "dark ones crushed": lambda x: np.clip((x - 0.08) / 0.92, 0.0, 1.0) ** 2.0,
    "light ones crushed": lambda x: np.clip(x / 0.9, 0.0, 1.0) ** 2.0,
    "blue crushed": lambda x: np.concatenate([x**2.2, x**2.2, limited(x) ** 2.2], axis=-1),
    "no grey": lambda x: np.round(x),
}


class Bench:
    """Panels that switch at once and leak, a room, a lamp: light is a sum over refreshes."""

    def __init__(
        self,
        projector: float,
        mask: float,
        room: float,
        lamp: dict[str, float],
        curves: tuple[str, str],
        tint: tuple[float, float, float],
    ) -> None:
        self.leaks, self.room, self.lamp = (1.0 / projector, 1.0 / mask), room, lamp
        self.curves, self.colours = [CURVES[name] for name in curves], COLOURS * tint
        self.rng = np.random.default_rng(5)
        self.taken_ns = 0

    def taken(self, wanted: PhotoRequest) -> Any:
        self.taken_ns += 10 * 10**9
        open_s = wanted.shown.refreshes * T + 0.1
        said = RawSettings(iso=100, f_number=wanted.f_number, exposure_s=open_s)
        return SimpleNamespace(wanted=wanted, seen=said, open_s=open_s, open_ns=self.taken_ns)

    def photo(self, session: Answered, taken: Any) -> QuadPhoto:
        wanted = taken.wanted
        shown = wanted.shown
        both = np.stack([shown.projector_index, shown.mask_index])
        pairs, counts = np.unique(both, axis=1, return_counts=True)
        lit_s, open_s = np.zeros((*SHAPE, 3)), np.zeros((*SHAPE, 3))
        for (first, second), count in zip(pairs.T, counts, strict=True):
            p = self._panel(shown.projector, int(first), 0) * (not wanted.covered)
            m = self._panel(shown.mask, int(second), 1)
            lit_s += count * T * p * m
            open_s += count * T * m
        full_dn = session.profile.saturation_dn(100)
        rate_dn = 0.65 * full_dn / (FULL * T) * (8.0 / wanted.f_number) ** 2
        lamp = self.lamp.get(shown.name, 1.0)
        light = rate_dn * (lamp * lit_s + self.room * open_s) * self.colours
        variance = np.full(light.shape, 4.0)
        noisy = light + 2.0 * self.rng.standard_normal(light.shape)
        return QuadPhoto(noisy, variance, (light > full_dn).any(axis=2))

    def _panel(self, patterns: Any, which: int, panel: int) -> np.ndarray:
        """What a panel lets pass at each quad, (h, w, 3)."""
        leak = self.leaks[panel]
        if which < 0:
            asked = np.full(SHAPE, float(which == WHITE))
        else:
            rows = np.arange(SHAPE[0]) * patterns.shape[1] // SHAPE[0]
            cols = np.arange(SHAPE[1]) * patterns.shape[2] // SHAPE[1]
            asked = patterns[which][rows][:, cols].astype(np.float64)
            asked /= 255.0 if patterns.dtype == np.uint8 else 1.0
        return np.asarray(leak + (1.0 - leak) * self.curves[panel](asked[..., None]))


@cache
def stepped(
    *,
    helped: bool = True,
    mask: float = 500.0,
    room: float = 0.002,
    lamp: tuple[tuple[str, float], ...] = (),
    gain: tuple[float, float] | None = None,
    estimated: bool = True,
    card: float | None = None,
    wide: tuple[float, ...] = (),
    curves: tuple[str, str] = ("linear", "linear"),
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
    known: tuple[float, float, float] | None = None,
    planes: Literal[1, 24] = 1,
) -> tuple[Answered, Run]:
    still = {"size_px": PANEL, "rise_s": 0.0, "fall_s": 0.0}
    bench = Bench(2000.0, mask, room, dict(lamp), curves, tint)
    said: dict[str, Any] = {"card_albedo": card}
    camera: dict[str, Any] = {}
    if known is not None:
        said["typed"], camera["responsivity_e"] = {"camera.responsivity_e": "null"}, known
    session = session_of(config(projector=still, mask=still, calibration=said, camera=camera))
    shown = msgspec.structs.replace(session.config.display, planes_per_refresh=planes)
    session.config = msgspec.structs.replace(session.config, display=shown)
    session.answer = lambda taken: bench.photo(session, taken)
    session.helped, session.full, session.f_number = helped, FULL, 8.0
    if wide:
        lens = (*wide, *session.camera.f_numbers)
        session.camera = replace(session.camera, f_numbers=lens)
    session.arrays[EDGE_KEY] = np.array([0.0, 1e-4])
    session.arrays[BLACK_SIGMA_KEY] = np.array([0.1])
    session.profile = msgspec.structs.replace(session.profile, estimated=estimated)
    if gain is not None:
        session.arrays[GAIN_KEY] = np.array(gain)
    return session, run(calibrate_light(session), bench.taken)


def test_both_contrasts_are_found_and_the_room_apart_from_black() -> None:
    _, found = stepped()
    out = found.outcome
    assert out is not None
    assert out.words["mask.contrast"].value == pytest.approx(500.0, rel=0.02)
    assert out.words["projector.contrast"].value == pytest.approx(2000.0, rel=0.05)
    # Of a card that reflects nine tenths, in units of a white card's light.
    ambient, sigma = np.asarray(out.arrays["light.ambient"]).tolist()
    assert ambient == pytest.approx(0.0018, rel=0.01) and 0.0 < sigma < 1e-4
    assert preview_of(out)[:4] == b"\x89PNG"


def test_the_lens_is_covered_where_that_is_asked_for_and_one_stop_serves_the_series() -> None:
    _, found = stepped()
    names = [wanted.shown.name for wanted in found.wanted]
    assert [wanted.covered for wanted in found.wanted] == [n in COVERED for n in names]
    assert [ask.text for ask in found.asked] == [COVER, UNCOVER]
    # The widest lens at which a second of light is not too much.
    of_stops = "stop-", "flash-"
    (f_number,) = {w.f_number for w in found.wanted if not w.shown.name.startswith(of_stops)}
    assert f_number is not None and 60 <= FULL * (f_number / 8.0) ** 2 < 80


def test_without_somebody_to_cover_the_lens_room_and_black_are_one() -> None:
    _, found = stepped(helped=False)
    assert not found.asked and not any(wanted.covered for wanted in found.wanted)
    out = found.outcome
    assert out is not None
    told = [text for text in out.advice if "could not be separated" in text]
    assert len(told) == 1 and "cover the projector's lens" in told[0]
    # What the room gives counts as the projector's black.
    contrast = out.words["projector.contrast"].value
    assert contrast == pytest.approx(1.0 / (1 / 2000.0 + 0.002), rel=0.02)
    doubtful = [f.name for f in out.figures if f.verdict is not Verdict.GOOD]
    assert doubtful == ["projector.contrast"] and len(out.advice) == 2
    assert "light.ambient" not in out.arrays


@pytest.mark.parametrize(
    ("gain", "estimated", "error"),
    [((2.5, 0.25), False, 0.1), ((2.5, 0.25), True, 0.2), (None, True, 0.2), (None, False, 0.0)],
)
def test_brightness_is_told_in_electrons_at_an_open_lens(
    gain: tuple[float, float] | None, estimated: bool, error: float
) -> None:
    """By the gain that was measured; out of a table of guesses it is known to a fifth."""
    session, found = stepped(gain=gain, estimated=estimated)
    out = found.outcome
    assert out is not None
    value = out.words["camera.responsivity_e"].value
    table = session.profile.row(100).gain_e_per_dn
    e_per_dn = table if gain is None or estimated else gain[0]
    full_dn = session.profile.saturation_dn(100)
    green = 0.65 * full_dn / (FULL * T) * 64.0 * e_per_dn / 0.9
    assert value == pytest.approx(tuple(green * COLOURS), rel=0.01)
    figure = out.figures[-1]
    assert (figure.name, figure.value) == ("camera.responsivity_e", value[1])
    assert figure.sigma / figure.value == pytest.approx(np.hypot(0.05 / 0.9, error), rel=0.02)


def test_the_scale_goes_by_what_the_cards_maker_says() -> None:
    """All of it: of a card that reflects 0.99 a unit of light is 0.9 / 0.99 of what it was taken
    for, to a hundredth."""
    values = []
    for card in (None, 0.99):
        out = stepped(gain=(2.5, 0.0), estimated=False, card=card)[1].outcome
        assert out is not None
        values.append(out.words["camera.responsivity_e"])
    unsaid, said = (np.array(found.value) for found in values)
    assert said == pytest.approx(unsaid * 0.9 / 0.99, rel=1e-6)
    assert np.array(values[1].sigma) / said == pytest.approx(0.01 / 0.99, rel=0.05)


def test_stops_are_compared_by_pulses_whose_number_fits_their_light() -> None:
    """The bench's lens is as engraved, which is not 2^(k/6)."""
    _, found = stepped(room=0.02)
    out = found.outcome
    assert out is not None
    own, *others = out.words["camera.stops"].value
    assert own["sigma"] == 0.0 and len(others) > 5
    for stop in others:
        light = (own["true"] / stop["true"]) ** 2
        engraved = (own["f_number"] / stop["f_number"]) ** 2
        assert light == pytest.approx(engraved, rel=max(5.0 * stop["sigma"], 2e-3))
        assert stop["sigma"] < 0.01
    shown = [w.shown for w in found.wanted if w.shown.name.startswith("stop-")]
    assert all((one.projector_index == one.mask_index).all() for one in shown)


def test_stops_that_are_too_wide_for_a_pulse_are_compared_by_flashes_of_the_projector() -> None:
    """All wider ones, beside the widest that pulses reach; however early or late a mask is."""
    _, found = stepped(room=0.02, wide=(1.0, 1.2, 1.4))
    out = found.outcome
    assert out is not None
    own, *others = out.words["camera.stops"].value
    compared = {stop["f_number"]: stop for stop in others}
    assert set(compared) >= {1.0, 1.2, 1.4}
    for f_number in (1.0, 1.2, 1.4):
        light = (own["true"] / compared[f_number]["true"]) ** 2
        assert light == pytest.approx((own["f_number"] / f_number) ** 2, rel=3e-3)
    short = [w for w in found.wanted if w.shown.name.startswith("flash-")]
    assert short[0].f_number == short[-1].f_number and len(short) >= 3
    for one in short:
        lit = np.flatnonzero(one.shown.projector_index == WHITE)
        assert all((one.shown.mask_index[lit + k] == WHITE).all() for k in (-2, -1, 0, 1))


DARK, LIGHT = "level_16", "level_239"


ALIKE = {
    "limited": (DARK, LIGHT), "dark ones crushed": (DARK,), "light ones crushed": (LIGHT,),
    "blue crushed": (DARK, LIGHT), "no grey": (DARK, LIGHT),
}  # fmt: skip
"""Levels that are not told from black or white; by other curves both are."""


@pytest.mark.parametrize(
    "curves",
    [
        ("linear", "gamma 2.2"), ("gamma 3", "gamma 0.5"), ("sRGB", "limited"),
        ("limited", "sRGB"), ("dark ones crushed", "light ones crushed"),
        ("no grey", "blue crushed"),
    ],
)  # fmt: skip
def test_a_range_that_no_server_tells_of_is_seen_by_two_levels(curves: tuple[str, str]) -> None:
    out = stepped(curves=curves)[1].outcome
    assert out is not None
    figures = {f.name: f for f in out.figures if ".level_" in f.name}
    advice = [text for text in out.advice if "full range" in text]
    for panel, curve in zip(("projector", "mask"), curves, strict=True):
        for level, name in ((16, DARK), (239, LIGHT)):
            found = figures.pop(f"{panel}.{name}")
            gives = CURVES[curve](np.full((1, 1), level / 255.0))
            want = float(gives.min() if name == DARK else gives.max())
            assert abs(found.value - want) < 4.0 * found.sigma, (found, want)
            alike = name in ALIKE.get(curve, ())
            assert (found.verdict is Verdict.DOUBTFUL) == alike
            assert sum(f"level {level} of the {panel} gives" in text for text in advice) == alike
    assert not figures


def test_panels_that_show_bits_are_shown_no_grey() -> None:
    found = stepped(planes=24)[1]
    assert not [one for one in found.wanted if one.shown.name.startswith(("dark-", "light-"))]


NIGHT = (1.0, 0.78**2.2, 0.53**2.2)
"""What a night light of 3400 K leaves of red, green and blue, at gamma 2.2."""


@pytest.mark.parametrize(
    ("tint", "known", "factor", "good"),
    [
        # An earlier calibration knows the colour of white; so does nobody, but for a guess.
        ((1.0, 1.0, 1.0), (7e6, 1e7, 8e6), 1.0, True),
        ((1.0, 1.0, 0.97), (7e6, 1e7, 8e6), 1 / 0.97, True),
        (NIGHT, (7e6, 1e7, 8e6), NIGHT[1] / NIGHT[2], False),
        ((1.0, 1.0, 1.0), None, 0.7 / (4.8 / 8.6), True),
        ((1.0, 1.0, 0.2), None, (5.6 / 8.6) / 0.16, False),
    ],
)
def test_a_white_of_another_colour_is_doubtful(
    tint: tuple[float, float, float],
    known: tuple[float, float, float] | None,
    factor: float,
    good: bool,
) -> None:
    out = stepped(tint=tint, known=known)[1].outcome
    assert out is not None
    (found,) = (f for f in out.figures if f.name == "light.white_colour")
    assert found.value == pytest.approx(factor, rel=0.01)
    assert (found.verdict is Verdict.GOOD) == good
    assert any("night lights, colour profiles" in text for text in out.advice) != good
