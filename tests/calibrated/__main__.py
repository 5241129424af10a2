"""Entry point: ``python -m tests.calibrated --benches 20 --out FOLDER`` from the root.

Each bench is calibrated from data-sheet values and compared with its truth; on the first
`--captures` of them an indirect photo is taken as believed, as measured and as it is. What is
done is kept in FOLDER/found.jsonl, a line a bench, and not done again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import msgspec
import numpy as np

from drivers.mock.camera import make_true_profile
from pdcd.bench.calibration import read_calibration
from pdcd.bench.config import load_config
from pdcd.bench.measured import apply_calibration as with_latest
from pdcd.bench.tables import CalibrationConfig, Config, SceneConfig
from pdcd.bench.truth import load_bench_truth
from pdcd.protocol.result import make_job_id
from pdcd.sensor.profile import load_profile
from tests import bench_rig, world
from tests.calibrated.compare import compared
from tests.calibrated.draw import drawn
from tests.taken import calibrate_once, request_of, started

LIMITS = {
    "camera to projector px": 0.1,
    "mask to projector px": 0.06,
    "blur share": 0.1,
    "lag ms": 0.15,
    "leak": 0.001,
    "projector.rise_s share": 0.06,
    "projector.fall_s share": 0.06,
    "mask.rise_s share": 0.06,
    "mask.fall_s share": 0.06,
    "projector.contrast share": 0.05,
    "mask.contrast share": 0.05,
    "ambient share": 0.02,
    "gain share": 0.005,
    "read noise share": 0.01,
    "shutter lag ms": 0.3,
    "error over that with the truth": 1.3,
}


def main() -> None:
    """Calibrate benches, print what each gave and a table of all."""
    world.enter()
    parser = argparse.ArgumentParser(prog="python -m tests.calibrated", description=__doc__)
    parser.add_argument("--benches", type=int, default=20)
    parser.add_argument("--captures", type=int, default=5)
    parser.add_argument("--quads", type=int, nargs=2, default=(534, 356), metavar=("W", "H"))
    parser.add_argument("--profile", default="450d", help="of the sensor; mono has no colours")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    kept = args.out / "found.jsonl"
    lines = kept.read_text().splitlines() if kept.exists() else []
    found = {entry["bench"]: entry for entry in map(json.loads, lines)}
    for seed in range(args.benches):
        if seed not in found:
            config = drawn(seed, args.out / f"bench-{seed}", tuple(args.quads), args.profile)
            found[seed] = _one(seed, args.out / f"bench-{seed}", config, seed < args.captures)
            with kept.open("a") as file:
                file.write(json.dumps(found[seed]) + "\n")
        sys.stdout.write(json.dumps(found[seed]) + "\n")
        sys.stdout.flush()
    sys.stdout.write(_table(list(found.values())))


def _one(seed: int, folder: Path, config: Config, capture: bool) -> dict[str, object]:
    begun_s = time.process_time()
    result = calibrate_once(config).result
    entry: dict[str, object] = {"bench": seed, "cpu_s": round(time.process_time() - begun_s, 1)}
    entry["state"], entry["summary"] = result.state, result.summary.get("verdict")
    if result.folder is None or result.state != "done":
        return {**entry, "error": result.error}
    record, _ = read_calibration(Path(result.folder))
    entry["computing_s"] = result.summary.get("computing_s")
    true = load_bench_truth(config).of(config)
    sensor = make_true_profile(load_profile(config.camera.profile), load_bench_truth(config).sensor)
    row = min(sensor.rows, key=lambda row: row.iso)
    entry |= compared(record, Path(result.folder), config, true, row)
    if capture:
        entry |= _captures(load_config(folder / "bench.toml"), true)
    return entry


def _captures(calibrated: Config, true: Config) -> dict[str, float | None]:
    """Relative RMS errors of an indirect photo of 64 x 48 cells, 128 codes, quarter windows."""
    scene = SceneConfig(kind="open-book", grid=(48, 64))
    uncalibrated = CalibrationConfig(use="none")
    # Whoever types a lag of more than a refresh also has the mask's pictures sent earlier.
    used = with_latest(calibrated)
    true = msgspec.structs.replace(true, display=used.display, schedule=used.schedule)
    ways = {
        "as measured": calibrated,
        "as it is": msgspec.structs.replace(true, calibration=uncalibrated),
        "as believed": msgspec.structs.replace(calibrated, calibration=uncalibrated),
    }
    request = request_of(codes=128, window="quarter")
    found: dict[str, float | None] = {}
    for name, config in ways.items():
        with started(msgspec.structs.replace(config, scene=scene)) as engine:
            result = bench_rig.capture(engine, request, make_job_id())
        found[f"error {name}"] = result.summary.get("rms_error_quads")  # type: ignore[assignment]
        found[f"folder {name}"] = result.folder  # type: ignore[assignment]
    measured, best = found["error as measured"], found["error as it is"]
    if measured and best:
        found["error over that with the truth"] = measured / best
    return found


def _table(entries: list[dict[str, object]]) -> str:
    rows = [f"\n{'quantity':32} benches  median     90 %    worst    limit  within\n"]
    for name, limit in LIMITS.items():
        values = np.array([e[name] for e in entries if name in e], dtype=np.float64)
        values = np.where(np.isfinite(values), values, np.inf)
        if values.size:
            at = [float(np.quantile(values, q, method="higher")) for q in (0.5, 0.9, 1.0)]
            share = f"{np.mean(values <= limit):.0%}"
            cells = "".join(f"{value:9.3g}" for value in (*at, limit))
            rows.append(f"{name:32} {values.size:5d} {cells}  {share:>6}\n")
    return "".join(rows)


if __name__ == "__main__":
    main()
