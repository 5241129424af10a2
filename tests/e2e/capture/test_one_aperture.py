"""A lens that is true to 2^(k/6) within 2 %, and engraved with other numbers: what photos say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdcd
from drivers.mock.camera import F_NUMBERS

NOMINAL = {f: 2.0 ** (round(6.0 * math.log2(f)) / 6.0) for f in F_NUMBERS}
TRUE = {f: nominal * (1.0 + 0.02 * math.sin(7.0 * f)) for f, nominal in NOMINAL.items()}


def shot(
    folder: Path, goal: Any, grid: tuple[int, int], *, true: bool = True, **options: Any
) -> pdcd.Run:
    truth = folder / "truth.toml"
    truth.write_text(
        "".join(f"[[sensor.stops]]\nf_number = {f}\ntrue = {TRUE[f]}\n" for f in F_NUMBERS)
    )
    config = {
        "scene": {"kind": "open-book", "grid": list(grid)},
        "server": {"state_dir": str(folder / "state")},
        "bench": {"truth": str(truth)} if true else {},
    }
    with pdcd.local(config) as bench:
        return bench.capture(goal, out=str(folder / "out"), **options)


def factor(image: np.ndarray, truth: np.ndarray) -> float:
    """What a picture is brighter by than the truth."""
    return float(np.sum(image * truth) / np.sum(truth * truth))


@pytest.mark.whole
def test_indirect_light_beside_white_is_true_without_a_factor(tmp_path: Path) -> None:
    """One stop for all: both are off by what that stop is, which no photo can tell."""
    run = shot(tmp_path, "indirect", (24, 32))
    record = run.manifest.run
    (f_number,) = {one.f_number for one in record.shots}
    assert [stop.f_number for stop in record.stops] == [f_number]
    off = (NOMINAL[f_number] / TRUE[f_number]) ** 2
    truth = np.load(Path(run.folder) / "truth.npz")["image"]
    assert factor(run.image, truth) == pytest.approx(off, rel=0.005)
    white = shot(tmp_path, "white", (24, 32), true=False).pictures["white"]
    assert factor(run.pictures["white"], white) == pytest.approx(off, rel=0.005)
    assert run.summary["scale"] == "of a nominal camera" and run.scale_sigma is None


@pytest.mark.whole
def test_where_two_stops_are_needed_their_ratio_is_measured_and_in_sigma(tmp_path: Path) -> None:
    run = shot(tmp_path, "long-range", (12, 16), radius=3)
    own, other = run.manifest.run.stops
    assert own.sigma == 0.0 and 0.0 < other.sigma < 0.03
    light = (other.true / own.true * TRUE[own.f_number] / TRUE[other.f_number]) ** 2
    assert abs(light - 1.0) < 3.0 * other.sigma
    taken = {one.f_number for one in run.manifest.run.shots}
    assert taken == {own.f_number, other.f_number}
    assert any("compared on the scene" in text for text in run.warnings)
    # The error bars of all that was taken at that stop hold it.
    names = {one.name for one in run.manifest.run.shots if one.f_number == other.f_number}
    if any(name.startswith("far") for name in names):
        known = np.isfinite(run.sigma)
        assert (run.sigma[known] >= 0.9 * other.sigma * np.abs(run.image[known])).all()
