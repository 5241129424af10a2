"""A bench by chance: what its user believes, and what it really is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pdcd.bench.config import load_config
from pdcd.bench.reading import format_toml
from pdcd.bench.tables import Config

PROJECTOR_PX, MASK_PX = (1024, 768), (1600, 1200)
SCAN_BANDS = 32
"""Panels set row after row, not in a few steps: as many bands as a mock photo has time for."""


def drawn(seed: int, folder: Path, quads: tuple[int, int], profile: str = "450d") -> Config:
    """The configuration of bench `seed`, written into `folder` beside its truth.

    quads : width and height of the frame. profile : of the camera's sensor. Believed are the data
    sheets: both panels and the camera fill the field, the panels are in step and switch at once,
    contrasts are round numbers.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.Generator(np.random.PCG64(seed))
    belief: dict[str, Any] = {
        "rig": {"name": f"bench {seed}"},
        "projector": {"size_px": PROJECTOR_PX},
        "mask": {"size_px": MASK_PX},
        "camera": {"profile": profile, "frame_quads": quads, "seed": seed},
        "scene": {"kind": "card"},
        "bench": {"truth": "truth.toml"},
        "server": {"state_dir": "state"},
    }
    truth = _truth(rng)
    for device in ("mask", "camera"):  # whoever hangs a device knows how
        belief[device]["place"] = {"flip": truth[device]["place"]["flip"]}
    (folder / "truth.toml").write_text(format_toml(truth))
    (folder / "bench.toml").write_text(format_toml(belief))
    return load_config(folder / "bench.toml")


def _truth(rng: np.random.Generator) -> dict[str, Any]:
    def within(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def by_factor(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    mirrored = bool(rng.integers(2))
    return {
        "projector": {
            "contrast": by_factor(500.0, 3000.0),
            "rise_s": within(0.0008, 0.004),
            "fall_s": within(0.0005, 0.003),
            "scan_s": within(0.0, 0.016),
            "scan_bands": SCAN_BANDS,
        },
        "mask": {
            "contrast": by_factor(200.0, 1000.0),
            "skew_s": within(-0.006, 0.012),
            "rise_s": within(0.002, 0.008),
            "fall_s": within(0.001, 0.005),
            "scan_s": within(-0.016, 0.016),
            "scan_bands": SCAN_BANDS,
            "place": {
                "flip": "horizontal" if mirrored else "none",
                "turn_deg": within(-1.0, 1.0),
                "scale": within(1.02, 1.08),
                "offset_px": [within(-5.0, 5.0), within(-5.0, 5.0)],
                "radial": [within(-0.004, 0.004), 0.0],
            },
        },
        "camera": {
            "blur_quads": within(0.3, 1.0),
            "place": {
                "flip": "vertical" if rng.integers(2) else "none",
                "turn_deg": within(-3.0, 3.0),
                "scale": within(1.03, 1.12),
                "offset_px": [within(-8.0, 8.0), within(-8.0, 8.0)],
                "radial": [within(-0.02, 0.02), 0.0],
                "tangential": [within(-0.002, 0.002), within(-0.002, 0.002)],
            },
        },
        "scene": {"ambient": by_factor(0.0005, 0.008), "blur_px": within(0.3, 1.2)},
        "sensor": {"gain": within(0.9, 1.1), "read_noise": within(0.8, 1.3)},
        "trigger": {"lag_s": within(0.03, 0.09), "jitter_s": within(0.001, 0.006)},
    }
