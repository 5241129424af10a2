"""One bench judged: calibrated, photographed, the same with the truth typed in, then spoilt."""

from __future__ import annotations

import dataclasses
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import pdcd
from pdcd.bench.calibration import read_calibration
from pdcd.bench.tables import CalibrationConfig
from pdcd.errors import PdcdError
from pdcd.words import GoalName, StepName
from tests.strangers import benches
from tests.strangers.compare import compare
from tests.strangers.package.strangers_bench.drivers import STANDS
from tests.strangers.package.strangers_bench.facts import Facts, draw_facts
from tests.strangers.package.strangers_bench.world import Stands, World
from tests.taken import calibrate_once

Entry = dict[str, Any]

GOALS: tuple[GoalName, ...] = ("indirect", "direct")
SPOILT = ("uncalibrated", "moved", "turned", "mirrored", "stretched", "says", "room", "whole")
SEED_OF_SPOILING = 13
BESIDE = 8.0
"""The stop that all others are compared with: which one a calibration goes by is its own choice."""


def judge(seed: int, folder: Path, *, small: bool = False, spoilt: int = 2) -> Entry:
    """Everything that is asked of pdcd on the bench of a seed, as one line of JSON.

    spoilt : how many spoilt photos are taken. The folder is made anew.
    """
    begun_s = time.monotonic()
    shutil.rmtree(folder, ignore_errors=True)
    facts = draw_facts(seed, small=small)
    files = benches.write_bench(facts, folder)
    entry: Entry = {"seed": seed, "small": small, "scene": facts.scene, "room": facts.room}
    card = Stands(stands="card")
    entry["calibrate"] = calibrate(files["sheet"], folder, card)
    if facts.mask_place.mirrored and "mirrored" in entry["calibrate"]["cause"]:
        # That is so, and nobody had said it: its owner says it now.
        files = benches.write_bench(facts, folder, mirrored=True)
        entry["calibrate"] = calibrate(files["sheet"], folder, card)
    if entry["calibrate"]["state"] == "done":
        entry["again"] = calibrate(files["sheet"], folder, card)
        entry["again"]["off_sigmas"] = _apart(entry["calibrate"], entry["again"])
    scene = Stands(stands="scene")
    for goal in GOALS:
        entry[goal] = photograph(files["sheet"], folder, facts, scene, goal)
        entry[f"true {goal}"] = photograph(files["truth"], folder, facts, scene, goal)
    rng = np.random.default_rng([seed, SEED_OF_SPOILING])
    for number in range(spoilt):
        how = SPOILT[(seed * spoilt + number) % len(SPOILT)]
        goal = GOALS[(seed + number) % len(GOALS)]
        stands, options, name = _spoil(how, scene, facts, rng)
        taken = photograph(files[name], folder, facts, stands, goal, **options)
        entry[f"spoilt {number}"] = {"how": how, "goal": goal} | taken
    entry["wall_s"] = round(time.monotonic() - begun_s, 1)
    return entry


def calibrate(file: Path, folder: Path, stands: Stands, *steps: StepName) -> Entry:
    """Steps of a calibration by data sheets, or all of them; what it ended with."""
    stands.save(folder / STANDS)
    begun_s = time.process_time()
    try:
        result = calibrate_once(benches.read_config(file), *steps).result
    except PdcdError as err:
        return {"state": "refused", "cause": err.message, "values": {}}
    cause = "" if result.error is None else str(result.error["message"])
    return {
        "state": result.state,
        "verdict": result.summary.get("verdict"),
        "passed": bool(result.passed) if result.state == "done" else False,
        "cause": cause or "; ".join(result.warnings[:2]),
        "cpu_s": round(time.process_time() - begun_s, 1),
        "values": _values(result.folder) if result.state == "done" and result.folder else {},
    }


def photograph(file: Path, folder: Path, facts: Facts, stands: Stands, goal: GoalName,
               **options: Any) -> Entry:  # fmt: skip
    """One plain capture, compared with the truth of what stands there before it is spoilt."""
    stands.save(folder / STANDS)
    begun_s = time.process_time()
    config = benches.read_config(file)
    if options.pop("uncalibrated", False):
        config = msgspec.structs.replace(config, calibration=CalibrationConfig(use="none"))
    try:
        with pdcd.local(config) as bench:
            run = bench.capture(goal, out=folder / "runs", progress=False, **options)
    except PdcdError as err:
        return {"state": "failed", "cause": err.message}
    taken: Entry = {"state": "done", "verdict": run.verdict, "reasons": list(run.quality.reasons)}
    world = World(facts, stands)
    names = [name for name in ("white", *GOALS) if name in run.pictures]
    found = compare(run, world, names)
    taken |= dataclasses.asdict(found[goal])
    taken["scales"] = {name: one.scale for name, one in found.items()}
    taken["cpu_s"] = round(time.process_time() - begun_s, 1)
    return taken


def _spoil(
    how: str, stands: Stands, facts: Facts, rng: np.random.Generator
) -> tuple[Stands, dict[str, Any], str]:
    """What stands there, options of the capture, and which configuration takes it."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    far = float(np.exp(rng.uniform(np.log(2.0), np.log(40.0))))
    changed: dict[str, Callable[[], Stands]] = {
        "moved": lambda: dataclasses.replace(
            stands, mask_shift_px=(far * float(np.cos(angle)), far * float(np.sin(angle)))
        ),
        "turned": lambda: dataclasses.replace(stands, mask_turn_deg=float(rng.uniform(0.7, 3.0))),
        "mirrored": lambda: dataclasses.replace(stands, mask_mirrored=True),
        "stretched": lambda: dataclasses.replace(stands, stretch=float(rng.uniform(1.5, 5.0))),
        "says": lambda: dataclasses.replace(stands, says_s=1.0 / 200.0),
        "room": lambda: dataclasses.replace(stands, room_later=facts.room + 0.2, room_after=3),
    }
    options: dict[str, Any] = {}
    if how == "uncalibrated":
        options["uncalibrated"] = True
    if how == "whole":
        options["window"] = "whole"
    return changed.get(how, lambda: stands)(), options, "sheet"


def _values(folder: str) -> dict[str, list[float]]:
    """Figures of a calibration that have a sigma, and the light of all stops, by key: value and
    sigma."""
    record, _ = read_calibration(Path(folder))
    measured = record.measured.get("camera.stops")
    stops = {} if measured is None else {one["f_number"]: one for one in measured.value}
    found = {}
    for f_number, stop in stops.items():
        if f_number != BESIDE and BESIDE in stops:
            sigma = np.hypot(stop["sigma"], stops[BESIDE]["sigma"])  # of light
            ratio = (stop["true"] / stops[BESIDE]["true"]) ** -2
            found[f"f/{f_number}"] = [ratio, ratio * float(sigma)]
    for step in record.steps:
        for figure in step.figures:
            if figure.sigma and figure.value is not None and np.isfinite(figure.value):
                found[figure.name] = [float(figure.value), float(figure.sigma)]
    return found


def _apart(one: Entry, other: Entry) -> dict[str, float]:
    """By how many of their sigmas two calibrations differ, by key."""
    found = {}
    for key, (value, sigma) in one["values"].items():
        if key in other["values"]:
            again, its_sigma = other["values"][key]
            found[key] = abs(value - again) / float(np.hypot(sigma, its_sigma))
    return found
