"""Error of the indirect image with pilots and priors, against codes that know nothing."""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

import msgspec
import numpy as np

from pdcd.codes.orders import is_order
from pdcd.codes.pilot.codes import MATCHED, choose_pilot_count
from pdcd.protocol.request import CaptureRequest
from tests.bench import plots
from tests.bench.captures import capture_with, config_for
from tests.bench.tables import Aim, Section, Table, percent
from tests.places import DATA
from tests.taken import started

GRID = (24, 32)
MIRRORS, BALL = ("mirror_32x24", "mirror-and-vase"), "disco-ball"
SCENES = (*MIRRORS, BALL, "corner_32x24")
COUNTS = (8, 16, 32, 48, 128, 512)
QUICK_COUNTS = (8, 128)
SEEDS = 3
COINS, NONE, SHORT, LONG, PRIOR = "128 coins", "no pilot", "short pilot", "long pilot", "own prior"
WAYS = (NONE, SHORT, LONG, PRIOR)
MANY = 128
LIMITS = {(MANY, "mirrors"): 0.1, (MANY, BALL): 0.2, (512, "mirrors"): 0.05, (512, BALL): 0.1}
"""Wanted error with a pilot, over that of as many coins."""

Errors = dict[tuple[str, int, str], float]


def run(*, quick: bool, folder: Path) -> Section:
    """Capture every scene every way, without sensor noise."""
    counts, seeds = (QUICK_COUNTS, 1) if quick else (COUNTS, SEEDS)
    errors: Errors = {}
    for scene, count, way in itertools.product(SCENES, counts, (COINS, *WAYS)):
        asked = _asked(scene, count, way)
        if asked is not None:
            found = [_error(scene, asked, seed) for seed in range(seeds)]
            errors[scene, count, way] = float(np.mean(found))
    _plot(errors, folder / "pilots.png")
    return Section(
        title="Pilots and priors",
        text=(
            "RMS error of the indirect photo over the RMS of the truth, whole captures on the "
            f"mock bench, {GRID[0]} x {GRID[1]} cells, full windows, no sensor noise, mean of "
            f"{seeds} seeds. K counts the pilot's codes. A short pilot is of "
            f"{', '.join(map(str, MATCHED))} photos and looks for a smooth map of partners; where "
            "it takes all codes there is no coded photo. A long one is of 32 to 128 photos and "
            "looks for single paths. '-': no pilot leaves enough codes. In brackets, how many "
            f"times smaller the error is than that of {MANY} coins, the paper's 30 s photo. Before "
            "the corner, pilots end after four photos."
        ),
        tables=[_table(errors, counts)],
        aims=_aims(errors, counts),
        plots=[("pilots.png", "Error against K, pilots included, no sensor noise.")],
    )


def _asked(scene: str, count: int, way: str) -> CaptureRequest | None:
    """The request, None where there is none."""
    base = CaptureRequest(goal="indirect", codes=count, white=False)
    if way == COINS:
        return msgspec.structs.replace(base, family="bernoulli")
    if way == NONE:
        return msgspec.structs.replace(base, pilot=0)
    if way == PRIOR:
        file = DATA / f"{scene}.npz"
        known = str(file) if file.exists() else f"scene:{scene}"
        return msgspec.structs.replace(base, prior=known)
    if way != SHORT:
        share = _choose_long_pilot(count)
    else:
        share = count if count in MATCHED else choose_pilot_count(count, 1)
    return msgspec.structs.replace(base, pilot=share) if share else None


def _choose_long_pilot(count: int) -> int:
    """At most two thirds of the codes, and leaving a Hadamard order; 0 if there is none."""
    fits = (n for n in (128, 64, 32) if 3 * n <= 2 * count and is_order(count - n))
    return next(fits, 0)


def _error(scene: str, request: CaptureRequest, seed: int) -> float:
    config = config_for(scene, GRID)
    camera = msgspec.structs.replace(config.camera, noise="none")
    config = msgspec.structs.replace(config, camera=camera)
    request = msgspec.structs.replace(request, seed=seed)
    files = {}
    if isinstance(request.prior, str) and not request.prior.startswith("scene:"):
        files["prior"] = Path(request.prior)
    with started(config) as engine, tempfile.TemporaryDirectory() as folder:
        result = capture_with(engine, request, Path(folder), f"pilot-{seed}", files)
    return float(str(result.summary["rms_error_quads"]))


def _table(errors: Errors, counts: tuple[int, ...]) -> Table:
    table = Table("Without noise", ("scene", "K", f"K {COINS.split()[1]}", *WAYS))
    for scene, count in itertools.product(SCENES, counts):
        base = errors[scene, MANY, COINS]
        cells = [percent(errors[scene, count, COINS])]
        for way in WAYS:
            error = errors.get((scene, count, way))
            cells.append("-" if error is None else f"{percent(error)} ({base / error:.3g}x)")
        table.add(scene, str(count), *cells)
    return table


def _aims(errors: Errors, counts: tuple[int, ...]) -> list[Aim]:
    def best(scene: str, count: int) -> float:
        return min(errors.get((scene, count, way), np.inf) for way in (SHORT, LONG))

    aims = []
    for (count, what), limit in LIMITS.items():
        if count in counts:
            scenes = MIRRORS if what == "mirrors" else (what,)
            worst = max(best(scene, count) / errors[scene, count, COINS] for scene in scenes)
            aims.append(
                Aim(f"error with a pilot over coins, K = {count}, {what}", "", worst, limit)
            )
    for count, scenes in ((8, MIRRORS), (48, (BALL,))):
        if count in counts:
            worst = max(best(scene, count) / errors[scene, MANY, COINS] for scene in scenes)
            name = (
                f"error of {count} codes, pilot included, over {MANY} coins, {' and '.join(scenes)}"
            )
            aims.append(Aim(name, "", worst, 1.0))
    return aims


def _plot(errors: Errors, path: Path) -> None:
    figure, axes = plots.panels(2, 2, scale=0.76, same_y=True)
    for scene, one in zip(SCENES, axes, strict=True):
        for index, way in enumerate((COINS, *WAYS)):
            points = [(k, 100.0 * e) for (s, k, w), e in errors.items() if (s, w) == (scene, way)]
            label = "coins" if way == COINS else way
            one.plot(*zip(*points, strict=True), **plots.style(index, ms=5, label=label))
        plots.finish(one, scene, "number of codes K", "RMS error in %")
    plots.legend(axes[1])
    plots.save(figure, path)
