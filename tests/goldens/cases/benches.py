"""What stands there: scenes, sensors, panels, places, faults of the display, a hidden truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.goldens.case import Bench, Case
from tests.goldens.cases.captures import GRID, Capture
from tests.places import ROOT

FAULTS = {
    "late": 'late = {"20" = 1, "60" = 2}',
    "dropped": "dropped = [20, 21, 60]",
    "stale-mask": "stale_mask = [13, 40]",
    "stale-projector": "stale_projector = [17, 52]",
    "all": 'late = {"20" = 1}\ndropped = [31]\nstale_mask = [43]\nstale_projector = [57]',
    "once": "dropped = [20]\nexposures = 1",
}
SCENES = (
    "open-book", "wax-disk", "disco-ball", "milky-bottle", "mirror-and-vase", "still-life",
    "ball-wax-book", "chart-in-milk", "glass-and-balls", "card",
)  # fmt: skip
OFF_AXIS = ("off-axis-box", "off-axis-wedge", "off-axis-shelf")
EXACT = '[camera]\nnoise = "none"\n'
PLACED = """
[projector.place]
turn_deg = 0.4
scale = 1.02
radial = [0.01, 0.0]
[mask.place]
flip = "horizontal"
turn_deg = 181.3
scale = 1.04
offset_px = [6.5, -3.25]
[camera]
frame_quads = [64, 48]
blur_quads = 0.6
[camera.place]
turn_deg = -2.5
scale = 1.1
radial = [0.02, -0.003]
tangential = [0.0004, -0.0002]
"""
WORN = """
[projector]
rise_s = 0.001
fall_s = 0.003
contrast = 500.0
jitter_s = 2e-4
skew_s = 1e-3
gamma = 2.2
scan_s = 0.008
scan_bands = 4
[mask]
refresh_hz = 59.7
phase_s = 0.004
rise_s = 0.009
fall_s = 0.005
contrast = 300.0
jitter_s = 3e-4
skew_s = -2e-3
gamma = 2.0
blur_px = 1.0
"""
TRUTH = """
[projector]
skew_s = 0.0004
rise_s = 0.0015
contrast = 900.0
gamma = 2.2
[mask]
skew_s = 0.0046
fall_s = 0.0063
contrast = 420.0
dead_rows = [611]
[mask.place]
turn_deg = 0.3
offset_px = [2.5, -1.25]
[camera]
blur_quads = 0.3
falloff = 0.3
[scene]
ambient = 0.01
blur_px = 0.5
[sensor]
gain = 1.03
read_noise = 1.1
prnu = 0.006
[trigger]
lag_s = 0.09
"""


def cases() -> list[Case]:
    """All of them."""
    plain = [*_faults(), *_scenes(), *_devices()]
    found = [replace(one, name=f"benches/{one.name}").case() for one in plain]
    found += [
        Capture(f"benches/scenes/matrix-{goal}", f"{goal} --codes 32 --parts 4", scene="matrix",
                scene_path="scene.npz").case(lambda bench: write_matrix(bench, "scene.npz"))
        for goal in ("indirect", "direct", "diagonal")
    ]  # fmt: skip
    truth = '[bench]\ntruth = "truth.toml"\n'
    for goal, parts in (("indirect", 1), ("direct", 4)):
        one = Capture(f"benches/truth/{goal}", f"{goal} --codes 32 --parts {parts}", truth)
        found.append(one.case(lambda bench: bench.write("truth.toml", TRUTH)))
    example = Capture(
        "benches/truth/example",
        "indirect --codes 8 --parts 1 --no-white --black-level none",
        truth + "[camera]\nframe_quads = [32, 24]\nf_number = 2.0\n",
        weight=40.0,
    )
    found.append(example.case(_copy_example))
    return found


def _faults() -> list[Capture]:
    """What the mock panels do wrong, under every way to go on."""
    found = []
    for fault, words in FAULTS.items():
        for miss in ("abort", "balance", "flag"):
            tables = f'[rig]\non_miss = "{miss}"\n[display.faults]\n{words}\n'
            options = "indirect --codes 32 --parts " + ("1" if miss == "balance" else "4")
            found.append(Capture(f"faults/{fault}-{miss}", options, tables))
    missed = '[rig]\non_miss = "flag"\n[display.faults]\ndropped = [40, 41]\n'
    balanced = missed.replace("flag", "balance")
    return [
        *found,
        Capture("faults/split", "split --period 4 --codes 64 --parts 1", missed),
        Capture("faults/pilot", "indirect --pilot 8 --codes 64 --parts 1", missed),
        Capture("faults/multi-image", "indirect --method multi-image --codes 16", balanced),
        Capture("faults/nayar", "direct --method nayar", missed),
    ]


def _scenes() -> list[Capture]:
    """Every scene preset: all its light, and what is not direct."""
    off = '[rig]\narrangement = "off-axis"\n'
    found = []
    for scene in (*SCENES, *OFF_AXIS):
        tables = off if scene in OFF_AXIS else ""
        found.append(Capture(f"scenes/{scene}", "indirect --codes 32 --parts 4", tables, scene))
        found.append(Capture(f"scenes/{scene}-exact", "white", tables + EXACT, scene))
    box = Capture("scenes/painted", "white", off, "off-axis-box", scene_options="painted = true")
    fine = Capture("scenes/fine", "indirect --codes 16 --parts 1", "[camera]\nquads_per_cell = 3\n")
    return [*found, box, fine]


def _devices() -> list[Capture]:
    """Sensors, panels with every defect, devices that lie anywhere."""
    indirect = "indirect --codes 32 --parts "
    return [
        Capture("devices/450d", indirect + "4", '[camera]\nprofile = "450d"\n'),
        Capture("devices/mark2", indirect + "1", '[camera]\nprofile = "mark2"\niso = 1600\n'),
        Capture("devices/fixed-stop", indirect + "1", "[camera]\nf_number = 4.0\nseed = 3\n"),
        Capture("devices/exact", indirect + "4", EXACT),
        Capture("devices/worn", indirect + "1", WORN),
        Capture("devices/worn-grey", "long-range --radius 2 --codes 32 --parts 4", WORN),
        Capture("devices/placed", indirect + "1", PLACED, weight=3.0),
        Capture("devices/placed-pixels", "diagonal --codes 32 --parts 4", PLACED, weight=3.0),
        Capture("devices/delayed-mask", indirect + "1", "[display]\nmask_delay_refreshes = -1\n"),
        Capture("devices/responsivity", indirect + "1",
                "[camera]\nresponsivity_e = [2e5, 4e5, 3e5]\n"),
        Capture("devices/code-grid", indirect + "1", "[schedule]\ngrid = [6, 8]\n"),
        Capture("devices/lag", indirect + "1", "[trigger]\nlag_s = 0.1\njitter_s = 0.02\n"),
        Capture("devices/long", indirect + "1 --exposure 700", "[limits]\nmax_exposure_s = 5\n"),
    ]  # fmt: skip


def write_matrix(bench: Bench, name: str) -> str:
    """A small synthetic light transport: a bright diagonal, near scattering, a few mirror paths."""
    rng = np.random.default_rng(11)
    rows, cols = (axis.ravel() for axis in np.indices(GRID))
    far = np.hypot(np.subtract.outer(rows, rows), np.subtract.outer(cols, cols))
    n = rows.size
    transport = 0.02 * np.exp(-far / 2.0) + np.diag(0.3 + 0.4 * rng.random(n))
    mirrored = rows * GRID[1] + (GRID[1] - 1 - cols)
    some = rng.random(n) < 0.2
    transport[np.arange(n)[some], mirrored[some]] += 0.2
    np.savez(bench.scratch / name, transport=transport, grid=np.array(GRID))
    return name


def _copy_example(bench: Bench) -> None:
    """The truth that comes as an example."""
    bench.write("truth.toml", (ROOT / "config" / "truth.toml").read_text())
