"""Calibrations of mock benches with a hidden truth, and captures by what they found."""

from __future__ import annotations

from collections.abc import Callable

from tests.goldens.case import Bench, Case
from tests.goldens.keep import keep_run
from tests.goldens.program import Said

BELIEF = """
[projector]
size_px = [256, 192]
[mask]
size_px = [400, 300]
[camera]
profile = "450d"
seed = 5
frame_quads = [{quads}]
{camera}
[scene]
kind = "{scene}"
grid = [12, 16]
[bench]
truth = "truth.toml"
"""
TRUTH = """
[projector]
skew_s = 0.0004
rise_s = 0.0015
fall_s = 0.0022
contrast = 900.0
gamma = 2.2
scan_s = 0.012
scan_bands = 8
[mask]
skew_s = 0.0046
rise_s = 0.0041
fall_s = 0.0063
contrast = 420.0
gamma = 2.0
scan_s = 0.010
scan_bands = 8
[mask.place]
turn_deg = 0.7
offset_px = [1.3, -0.7]
scale = 1.04
[camera]
blur_quads = 0.5
[camera.place]
turn_deg = -1.4
offset_px = [2.0, 1.0]
scale = 1.04
[scene]
ambient = 0.004
blur_px = 0.5
[sensor]
gain = 1.03
read_noise = 1.1
[trigger]
lag_s = 0.085
jitter_s = 0.003
"""
PLACES = """
[mask.place]
turn_deg = 1.0
scale = 1.04
offset_px = [1.0, -2.0]
[camera.place]
scale = 1.08
"""


def cases() -> list[Case]:
    """A whole calibration and what follows; geometry by all marks, on a card and on a scene."""
    return [
        Case("calibrations/whole", _take_whole, 70.0),
        *(
            Case(f"calibrations/geometry-{marks}", _geometry(marks), 8.0)
            for marks in ("dots", "xor")
        ),
        Case("calibrations/scene", _take_scene, 15.0),
        Case("calibrations/disparity", _take_disparity, 12.0),
        Case("calibrations/off", _take_off, 8.0),
        Case("calibrations/refused", _take_refused, 3.0),
    ]


def _configure(
    bench: Bench, truth: str, *, quads: str = "256, 192", scene: str = "card", camera: str = ""
) -> str:
    bench.write("truth.toml", truth)
    text = BELIEF.format(quads=quads, scene=scene, camera=camera)
    return bench.write("bench.toml", text)


def _calibrate(bench: Bench, name: str, *words: str, config: str = "bench.toml") -> Said:
    """Calibrate, and keep what was found."""
    said = bench.pdcd("calibrate", *words, "--local", "--json", "--config", config)
    bench.keep_said(f"{name}", said)
    if said.folder is not None:
        keep_run(bench, said.folder, name)
    return said


def _capture(bench: Bench, name: str, options: str, config: str = "bench.toml") -> None:
    words = [*options.split(), "--local", "--json", "--config", config]
    said = bench.pdcd("capture", *words, "--out", "runs")
    bench.keep_said(name, said)
    if said.folder is not None:
        keep_run(bench, said.folder, name)


def _take_whole(bench: Bench) -> None:
    """All steps at once, those that are asked for by name, a check, and photos by the result."""
    config = _configure(bench, TRUTH)
    whole = _calibrate(bench, "all")
    _calibrate(bench, "response", "response")
    _calibrate(bench, "focus", "focus")
    _calibrate(bench, "check", "check")
    bench.keep_said("config", bench.pdcd("config", "show", "--config", config))
    if whole.folder is not None:
        bench.keep_said("again", bench.pdcd("calibrate", "--again", str(whole.folder), "--json"))
        bench.keep_said("verify", bench.pdcd("verify", str(whole.folder), "--json"))
    text = (bench.scratch / config).read_text().replace("card", "open-book")
    book = bench.write("book.toml", text)
    _capture(bench, "photo-1", "indirect --codes 32 --parts 1", book)
    _capture(bench, "photo-4", "direct --codes 32 --parts 4", book)


def _geometry(marks: str) -> Callable[[Bench], None]:
    def take(bench: Bench) -> None:
        _configure(bench, PLACES, quads="360, 240")
        _calibrate(bench, "geometry", "geometry", "--marks", marks)

    return take


def _take_scene(bench: Bench) -> None:
    """Geometry before a scene, by XOR codes and then by phases; a bench that was bumped."""
    _configure(bench, PLACES, quads="360, 240", scene="open-book")
    _calibrate(bench, "first", "geometry", "--scene")
    bench.write("truth.toml", PLACES.replace("1.08", "1.09"))
    _calibrate(bench, "bumped", "geometry", "--scene")
    _calibrate(bench, "registration", "registration", "--scene")
    _capture(bench, "photo", "indirect --codes 16 --parts 1")


def _take_disparity(bench: Bench) -> None:
    """Depths before an off-axis bench, and a photo keyed by them."""
    for scene, step, more in (("card", "geometry", ""), ("off-axis-wedge", "disparity", "--scene")):
        config = _configure(bench, "", scene=scene, quads="256, 192")
        text = (bench.scratch / config).read_text()
        bench.write("bench.toml", '[rig]\narrangement = "off-axis"\n' + text)
        _calibrate(bench, step, step, *more.split())


def _take_off(bench: Bench) -> None:
    """Single steps without those they rest on, kept step by step; a bench with a late mask."""
    late = "[mask]\nskew_s = 0.0346\ncontrast = 300.0\n"
    _configure(bench, late)
    _calibrate(bench, "light", "sensor", "light")
    _calibrate(bench, "timing", "geometry", "timing")
    _capture(bench, "photo", "indirect --codes 16 --parts 1")


def _take_refused(bench: Bench) -> None:
    """What cannot be calibrated says why."""
    _configure(bench, TRUTH)
    _calibrate(bench, "focus-first", "focus")
    _calibrate(bench, "unknown", "nonsense")
    _calibrate(bench, "disparity-on-card", "disparity")
