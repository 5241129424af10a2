"""Codes that were lost on the way, repaired by dividing each cell by its own realised weight."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import (
    DisplayConfig,
    FaultsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
    ScheduleConfig,
)
from tests import bench_rig
from tests.places import DATA
from tests.taken import take

CODES = 128
LOST = np.sort(np.random.default_rng(5).choice(CODES, 16, replace=False))
FAULTS = {
    "stale": FaultsConfig(stale_mask=tuple(3 * int(k) + 1 for k in LOST)),
    "late, dropped and stale": FaultsConfig(
        stale_mask=tuple(3 * int(k) + 1 for k in LOST[:6]),
        dropped=tuple(3 * int(k) + 1 for k in LOST[6:11]),
        late={str(3 * int(k) + 2): 1 for k in LOST[11:]},
    ),
    "none": FaultsConfig(),
}
"""16 of 128 codes: the mask stays shut, both panels stay back, or the code is shown for twice as
long."""

LEAKS = {
    "projector": PanelConfig(size_px=(1024, 768), contrast=100.0),
    "mask": PanelConfig(size_px=(1600, 1200), contrast=50.0),
}


def error(folder: Path, faults: str, *, ambient: float = 0.0, **fields: Any) -> float:
    """RMS error of the indirect picture of a diffuse corner, without sensor noise."""
    folder.mkdir(exist_ok=True)
    leaks: dict[str, Any] = LEAKS if ambient else {}
    path = str(DATA / "corner_32x24.npz")
    config = bench_rig.config(
        folder,
        scene=SceneConfig(kind="matrix", path=path, ambient=ambient),
        rig=RigConfig(on_miss="flag"),
        display=DisplayConfig(faults=FAULTS[faults]),
        **leaks,
    )
    made = take(config, **{"codes": CODES, "pilot": 0, "parts": 1, "white": False, **fields})
    shots = made.manifest.run.shots
    assert all(shot.missed == (0 if faults == "none" else 16) for shot in shots)
    return made.error


@pytest.mark.long
@pytest.mark.parametrize("faults", ["stale", "late, dropped and stale"])
def test_lost_codes_are_repaired_by_weights_of_each_cell(faults: str, tmp_path: Path) -> None:
    plain = error(tmp_path / "scalar", faults, normalise="scalar", smooth=False)
    assert plain > 0.03
    assert error(tmp_path / "smooth", faults, normalise="scalar") < 0.01  # the image tells as much
    repaired = error(tmp_path / "auto", faults)
    assert repaired < 0.01
    assert error(tmp_path / "row", faults, normalise="row") == repaired


def test_without_a_loss_one_number_is_what_auto_takes(tmp_path: Path) -> None:
    auto = error(tmp_path / "auto", "none")
    assert auto == error(tmp_path / "scalar", "none", normalise="scalar")
    assert auto != error(tmp_path / "row", "none", normalise="row")


def test_repair_and_black_levels_work_together(tmp_path: Path) -> None:
    """Leaks of 1 % and 2 % and a lit room add nothing once the four photos are combined."""
    faults = "late, dropped and stale"
    sound = error(tmp_path / "sound", faults)
    spoilt = error(tmp_path / "spoilt", faults, ambient=0.3)
    mended = error(tmp_path / "mended", faults, ambient=0.3, black_level="both")
    assert spoilt > 1.0
    assert mended < 0.01
    assert mended == pytest.approx(sound, rel=0.15)  # each of four files is quantised


def test_the_configuration_may_ask_for_it(tmp_path: Path) -> None:
    schedule = ScheduleConfig(codes=8, normalise="row")
    made = take(bench_rig.config(tmp_path, schedule=schedule))
    assert made.manifest.run.normalise == "row"
