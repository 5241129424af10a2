"""What engraved stops stand for, and what the scale of a run goes by."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from pdcd.bench import measured
from pdcd.bench.stops import STOP_SIGMA, AbsoluteScale, Stop, compute_light_sigma, stop_of
from pdcd.bench.tables import Config

MARKS = (
    1, 1.1, 1.4, 1.6, 1.8, 2, 2.2, 2.5, 2.8, 3.2, 3.5, 4, 4.5, 5, 5.6, 6.3, 7.1, 8, 9, 10, 11, 13,
    14, 16, 18, 20, 22,
)  # fmt: skip
"""As lenses are engraved, a third of a stop apart, from 2^0 on; 1.2 stands between two of them."""
THIRDS = (0, 1, 3, 4, *range(5, 28))


@pytest.mark.parametrize(("mark", "third"), list(zip(MARKS, THIRDS, strict=True)))
def test_engraved_numbers_stand_for_thirds(mark: float, third: int) -> None:
    stop = stop_of(mark)
    assert stop.true == pytest.approx(2.0 ** (third / 6.0)) and stop.sigma == STOP_SIGMA


@pytest.mark.parametrize("mark", [1.7, 2.4, 3.3, 4.8, 6.7, 9.5, 19.0])
def test_half_stops_are_what_they_say(mark: float) -> None:
    assert stop_of(mark).true == mark


def test_measured_stops_are_known_and_two_others_are_unsure_alike() -> None:
    known = (Stop(8.0, 8.1, 0.0), Stop(11.0, 11.2, 0.002))
    assert stop_of(11.0, known) is known[1] and stop_of(13.0, known).true == 2.0 ** (22 / 6)
    assert compute_light_sigma(*known) == 0.002 and compute_light_sigma(known[0], known[0]) == 0.0
    assert compute_light_sigma(stop_of(11.0), stop_of(13.0)) == pytest.approx(0.0566, rel=1e-3)


def test_the_scale_says_what_it_goes_by(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    replace = msgspec.structs.replace
    config = Config()
    assert measured.find_scale(config, 8.0) == AbsoluteScale("of a nominal camera")
    stops = (Stop(8.0, 8.0, 0.0), Stop(11.0, 11.2, 0.04))
    camera = replace(config.camera, responsivity_e=(1e6, 2e6, 1e6), stops=stops)
    config = replace(config, camera=camera)
    assert measured.find_scale(config, 8.0) == AbsoluteScale("as typed")
    entry = SimpleNamespace(sigma=(3e4, 4e4, 2e4), made_utc="2026-01-01T10:00:00Z")
    record: Any = SimpleNamespace(measured={"camera.responsivity_e": entry})
    monkeypatch.setattr(measured, "read_calibration", lambda folder: (record, "a" * 64))
    table = replace(config.calibration, use=str(tmp_path), sha256="a" * 64)
    config = replace(config, calibration=table)
    for f_number, sigma in (
        (8.0, 0.03),
        (11.0, 0.05),
        (13.0, math.hypot(0.03, math.hypot(STOP_SIGMA, STOP_SIGMA))),
    ):
        found = measured.find_scale(config, f_number)
        assert found.source == "as of the calibration of 2026-01-01"
        assert found.sigma == pytest.approx(sigma)
    record.measured = {}
    assert measured.find_scale(config, 8.0) == AbsoluteScale("as typed")
