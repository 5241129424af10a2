"""What `pdcd calibrate` costs: photos, exposures and computing of every step, on a whole frame."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from pdcd.bench.calibration import Calibration, read_calibration
from pdcd.bench.config import load_config
from pdcd.bench.reading import format_toml
from pdcd.capture.again import recompute_calibration
from tests.bench.measure import alone, peak_mib
from tests.bench.tables import Aim, Section, Table, seconds
from tests.taken import calibrate_once

FRAME, QUICK_FRAME = (2136, 1424), (534, 356)
"""Width and height in quads: a RAW file has twice as many samples each way."""
LIMIT_S, LIMIT_MIB = 60.0, 1536.0
TIMEOUT_S = 3600.0
"""Photos of the mock camera take longer than what is measured."""
TRUTH: dict[str, Any] = {
    "projector": {"contrast": 1500.0, "rise_s": 0.002, "fall_s": 0.0015},
    "mask": {
        "contrast": 500.0,
        "skew_s": 0.003,
        "rise_s": 0.005,
        "fall_s": 0.003,
        "place": {"turn_deg": 0.5, "scale": 1.04, "offset_px": [3.0, -2.0]},
    },
    "camera": {
        "blur_quads": 0.6,
        "place": {"turn_deg": -1.5, "scale": 1.06, "radial": [0.01, 0.0]},
    },
    "scene": {"ambient": 0.002, "blur_px": 0.6},
}


def run(*, quick: bool, folder: Path) -> Section:
    """Calibrate once, in processes of their own."""
    del folder  # no plots
    width, height = QUICK_FRAME if quick else FRAME
    with tempfile.TemporaryDirectory(prefix="pdcd-bench-") as place:
        keywords = {"place": place, "quads": [width, height]}
        found = alone("calibrating:taken", TIMEOUT_S, **keywords)
        computed = alone("calibrating:computed", TIMEOUT_S, folder=found["folder"])
    raw = f"RAW {2 * width}x{2 * height}"
    table = Table(
        f"Steps of `pdcd calibrate`, {raw}", ("step", "photos", "open shutter", "computing")
    )
    for step in found["steps"]:
        times = (seconds(step[key]) for key in ("open_s", "computing_s"))
        table.add(step["name"], str(step["photos"]), *times)
    sums = {
        key: sum(step[key] for step in found["steps"]) for key in found["steps"][0] if key != "name"
    }
    table.add("all", str(sums["photos"]), seconds(sums["open_s"]), seconds(sums["computing_s"]))
    whole = f"a whole calibration, computing, {raw}"
    return Section(
        title="Calibration",
        text=(
            "A mock bench whose panels and camera are turned, slow and leaking, from data-sheet "
            "values, all steps that need no other card. Computing is what comes between the "
            f"photos. Its memory, {computed['peak_mib']:.0f} MiB, is that of "
            "`pdcd calibrate --again`, which computes the same from the same photos without a "
            f"camera: in {seconds(computed['seconds'])}. The bench calls itself {found['verdict']}."
        ),
        tables=[table],
        aims=[
            Aim(whole, "s", sums["computing_s"], LIMIT_S),
            Aim(f"{whole}: memory", "MiB", computed["peak_mib"], LIMIT_MIB),
        ],
    )


def taken(place: str, quads: list[int]) -> dict[str, Any]:
    """A calibration of the bench: its folder and what its steps took."""
    config = Path(place) / "bench.toml"
    belief = {
        "projector": {"size_px": [1024, 768]},
        "mask": {"size_px": [1600, 1200]},
        "camera": {"profile": "450d", "frame_quads": quads, "seed": 1},
        "scene": {"kind": "card"},
        "bench": {"truth": "truth.toml"},
        "server": {"state_dir": "state"},
    }
    config.write_text(format_toml(belief))
    (Path(place) / "truth.toml").write_text(format_toml(TRUTH))
    result = calibrate_once(load_config(config)).result
    if result.folder is None:
        raise RuntimeError(f"the bench was not calibrated: {result.error}")
    record, _ = read_calibration(Path(result.folder))
    return {"folder": result.folder, "verdict": record.verdict, "steps": _steps(record)}


def _steps(record: Calibration) -> list[dict[str, Any]]:
    return [
        {
            "name": step.name,
            "photos": len(step.photos),
            "open_s": sum(photo.close_ns - photo.open_ns for photo in step.photos) * 1e-9,
            "computing_s": step.seconds,
        }
        for step in record.steps
    ]


def computed(folder: str) -> dict[str, float]:
    """The same calibration computed again: seconds and peak memory. Raises RuntimeError when it
    comes out different."""
    begun_s = time.perf_counter()
    found = recompute_calibration(Path(folder))
    if not found.identical:
        raise RuntimeError("the calibration comes out different")
    return {"seconds": time.perf_counter() - begun_s, "peak_mib": peak_mib()}
