"""All steps on the bench of `config/truth.toml`, in small; the photo after them, and all again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.calibration import Calibration, read_calibration
from pdcd.bench.reading import format_toml
from pdcd.calibration import steps
from pdcd.cli.main import main
from pdcd.runs.folder import read_manifest
from tests.places import ROOT

pytestmark = pytest.mark.whole

QUADS, CELLS = (200, 150), (12, 16)
TRUTH = ROOT / "config" / "truth.toml"
BENCH: dict[str, dict[str, object]] = {
    "rig": {"name": "small"},
    "projector": {"size_px": (160, 120)},
    "mask": {"size_px": (250, 188), "place": {"flip": "horizontal", "turn_deg": 180.0}},
    "camera": {"frame_quads": QUADS},
    "scene": {"grid": CELLS},
    "bench": {"truth": str(TRUTH)},
    "server": {"state_dir": "state"},
}
"""As few pixels as all steps can do with."""
STOPS = {"modern": 36.0, "mono": 114.0}
"""The one stop that the light of that truth calls for, by the sensor."""
TRUE = {
    "projector.contrast": 1500.0, "projector.rise_s": 0.0015, "projector.fall_s": 0.0022,
    "mask.contrast": 420.0, "mask.rise_s": 0.0041, "mask.fall_s": 0.0093,
    "mask.blur_px": 0.5, "scene.ambient": 0.01, "trigger.lag_s": 0.116,
}  # fmt: skip
"""As the file has them."""
CLOSE = 0.02
"""What a share of a true value a figure may be off beyond three of its sigmas: models have errors
that their sigmas leave out."""


def calibrate(
    path: Path, capsys: pytest.CaptureFixture[str], *more: str
) -> tuple[dict[str, object], Calibration]:
    """All steps, by the command line: its last line, and the record."""
    code = main(["calibrate", "--local", "--json", "--config", str(path), *more])
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 0, last
    return last, read_calibration(Path(str(last["folder"])))[0]


def values(record: Calibration) -> dict[str, tuple[float, float]]:
    """Figures that have a sigma, each with it."""
    return {
        figure.name: (figure.value, figure.sigma)
        for step in record.steps
        for figure in step.figures
        if figure.value is not None and figure.sigma
    }


def photograph(
    bench: Path, calibrated: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> tuple[float, float]:
    """A plain photo by that calibration, which is not bad: its error on cells, and what it says of
    that by its scale and the error bars of as many quads as a cell has."""
    words = ["--local", "--json", "--config", str(bench), "--out", str(bench.parent / "runs")]
    assert main(["capture", "indirect", *words]) == 0
    taken = json.loads(capsys.readouterr().out.splitlines()[-1])
    manifest = read_manifest(Path(taken["folder"]))
    assert manifest.config["calibration"]["use"] == calibrated["folder"]
    assert manifest.config["mask"]["place"]["map"]["residual"]
    assert manifest.run.times_known
    summary = taken["summary"]
    assert taken["state"] == "done" and summary["quality"]["verdict"] != "bad", summary
    quads = float(np.prod(QUADS)) / float(np.prod(CELLS))
    stated = np.hypot(summary["scale_sigma"], summary["rms_sigma"] / np.sqrt(quads))
    return float(summary["rms_error_cells"]), float(stated)


@pytest.fixture(scope="module", params=STOPS)
def bench(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    path = tmp_path_factory.mktemp("whole") / "bench.toml"
    camera = {**BENCH["camera"], "profile": request.param, "f_number": STOPS[request.param]}
    path.write_text(format_toml({**BENCH, "camera": camera}))
    return path


@pytest.mark.timeout(1800)
def test_all_steps_by_the_command_line(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    last, record = calibrate(bench, capsys)
    assert last["passed"] is True and record.verdict != "bad" and not record.left_out
    names = [name for name in steps.STEP_SCRIPTS if name not in steps.AT_WISH]
    assert [step.name for step in record.steps] == ["meter", *names]
    # A map is not sure at the edge of so small a photo. One sample of a small well has several
    # times the noise of a quad, which makes a single exposure of the shutter less sure.
    doubted = {step.name for step in record.steps if step.verdict != "good"}
    doubts = {"geometry", *(("shutter",) if len(record.camera.responsivity_e) == 1 else ())}
    assert doubted <= doubts, doubted
    found = values(record)
    for name, true in TRUE.items():
        value, sigma = found[name]
        assert abs(value - true) <= 3.0 * sigma + CLOSE * true, (name, value, sigma)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_plain_photo_of_indirect_light_after_all_steps(
    bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    last, _ = calibrate(bench, capsys)
    error, stated = photograph(bench, last, capsys)
    assert error < max(0.05, 2.0 * stated)
