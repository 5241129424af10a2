"""What three benches can do: the paper's devices, a machine-vision camera in their place, and two
DMDs. Each takes a plain indirect photo on the virtual clock."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pdcd
from tests.bench.tables import Section, Table, percent, seconds

PAPER_CODES_A_SECOND, PAPER_LIGHT = 20.0, 1 / 48
SCENE = "open-book"
_SCENE = {"kind": SCENE, "grid": [48, 64]}
_MONO = {"profile": "mono"}
_PANEL = {"size_px": [1920, 1080], "refresh_hz": 1e6 / 105.0, "rise_s": 0.0, "fall_s": 0.0}
BENCHES: dict[str, dict[str, Any]] = {
    "projector, LCD, DSLR (450D)": {"camera": {"profile": "450d"}, "scene": _SCENE},
    "projector, LCD, monochrome camera": {"camera": _MONO, "scene": _SCENE},
    "two DMDs, monochrome camera": {
        "rig": {"settle_s": 0.002},
        "projector": _PANEL,
        "mask": {**_PANEL, "skew_s": 2e-6},
        "display": {"row_times": True},
        "trigger": {"lag_s": 0.0, "jitter_s": 0.0},
        "camera": _MONO,
        "scene": _SCENE,
    },
}


def run(*, quick: bool, folder: Path) -> Section:
    """A row a bench; the paper's first."""
    del folder  # no plots
    table = Table(
        "A plain photo of indirect light, 48 x 64 cells",
        (
            "bench",
            "codes",
            "codes a second",
            "light",
            "exposures",
            "RMS error",
            "RMS sigma",
            "verdict",
        ),
    )
    table.add(
        "the paper's", "", f"{PAPER_CODES_A_SECOND:.0f}", percent(PAPER_LIGHT), "", "", "", ""
    )
    for name, tables in list(BENCHES.items())[: 1 if quick else None]:
        with tempfile.TemporaryDirectory() as kept, pdcd.local(tables, folder=kept) as bench:
            plan = bench.plan("indirect")
            coded = [shot for shot in plan.shots if shot.codes > 1]
            codes = sum(shot.exposures * shot.codes for shot in coded)
            lit_s = sum(shot.exposures * shot.exposure_s for shot in coded)
            got = bench.capture("indirect", seed=1)
            taken_s = got.summary["exposure_s"]
            assert isinstance(taken_s, float)
            table.add(
                name,
                str(got.summary["codes"]),
                f"{codes / lit_s:.0f}",
                percent(plan.light_share),
                seconds(taken_s),
                percent(got.rms_error_quads or 0.0),
                percent(got.rms_sigma or 0.0),
                got.verdict,
            )
    return Section(
        title="Three benches",
        text=(
            f"Plain captures of the scene `{SCENE}` with full sensor noise. Light is that of a "
            "code photo over that of a floodlit one as long; the paper has 1/48 of it and 20 codes "
            "a second. Exposures are all of the run, without the time to read files."
        ),
        tables=[table],
        aims=[],
    )
