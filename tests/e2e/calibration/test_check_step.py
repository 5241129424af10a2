"""A check finds what has changed on a bench, and cries no wolf."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ServerConfig,
)
from pdcd.bench.truth import truth_of
from pdcd.calibration.figures import Verdict
from pdcd.calibration.script import Outcome
from pdcd.calibration.steps.check import KEPT, NO_LAG, check_bench
from pdcd.errors import CalibrationError
from pdcd.maps.map import between
from pdcd.maps.placing import Placing
from pdcd.offload.calibrating import read_arrays, write_arrays
from tests.e2e.calibration.hands import Hands
from tests.sampled import sampled

GOOD, REFIT, BAD = Verdict.GOOD, Verdict.DOUBTFUL, Verdict.BAD
T_S = 1.0 / 60.0
SKEW_S, CONTRAST = 3.7e-3, 450.0


@dataclass(frozen=True)
class Truth:
    """What of the bench changes from one look to the next."""

    skew_s: float = SKEW_S
    contrast: float = CONTRAST
    right_px: float = 1.3
    turn_deg: float = 0.7
    camera_px: float = 2.0
    albedo: float = 0.9
    iso: int = 100
    seed: int = 3

    def hands(self, folder: Path) -> Hands:
        """The bench as it is, believed to be as in the data sheets."""
        folder.mkdir(exist_ok=True)
        (folder / "truth.toml").write_text(
            f"""
            [projector]
            contrast = 900.0
            rise_s = 0.0031
            fall_s = 0.0022
            [mask]
            contrast = {self.contrast}
            skew_s = {self.skew_s}
            rise_s = 0.0045
            fall_s = 0.0071
            [mask.place]
            turn_deg = {self.turn_deg}
            offset_px = [{self.right_px}, -0.7]
            [camera]
            blur_quads = 0.5
            [camera.place]
            turn_deg = -1.4
            offset_px = [{self.camera_px}, 1.0]
            scale = 1.06
            """
        )
        config = Config(
            projector=PanelConfig(size_px=(256, 192)),
            mask=PanelConfig(size_px=(400, 300), contrast=CONTRAST),
            camera=CameraConfig(
                profile="450d", frame_quads=(300, 216), seed=self.seed, iso=self.iso
            ),
            scene=SceneConfig(kind="card", grid=(12, 16), options={"albedo": self.albedo}),
            bench=BenchConfig(truth=str(folder / "truth.toml")),
            server=ServerConfig(state_dir=str(folder / "state")),
        )
        return Hands(config, folder, full=80, f_number=22.0)


THEN = Truth()


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hands]:
    """A bench that was calibrated, with its look right after."""
    one = THEN.hands(tmp_path_factory.mktemp("reference"))
    one.knows_maps()
    one.session.arrays |= {
        "timing.bands": np.array([0.25, 0.75]),
        "timing.lag_s": np.full(2, SKEW_S),
        # Some per cent wrong, as times that were measured are.
        "timing.taus_s": np.array([3.2e-3, 2.1e-3, 4.4e-3, 7.3e-3]),
        "timing.leaks": np.array([1.0 / 900.0, 1.0 / CONTRAST]),
    }
    outcome = one.run("check", check_bench(one.session))
    assert outcome.advice == (KEPT,)
    assert one.photos == 4
    yield one


def later(reference: Hands, folder: Path, truth: Truth) -> Hands:
    """The same bench some days later, with what is known of it."""
    found = truth.hands(folder)
    config, known = found.session.config, reference.session.config
    for name in ("projector", "mask", "camera"):
        table = getattr(config, name)
        table = msgspec.structs.replace(table, place=Placing(map=reference.session.found(name)))
        config = msgspec.structs.replace(config, **{name: table})
    mask = msgspec.structs.replace(config.mask, skew_s=known.mask.skew_s)
    found.session.config = msgspec.structs.replace(config, mask=mask)
    write_arrays(folder / "arrays.npz", reference.session.arrays)
    found.session.arrays = read_arrays(folder / "arrays.npz")
    return found


def verdicts(outcome: Outcome) -> dict[str, Verdict]:
    return {f.name: f.verdict for f in outcome.figures if f.verdict is not GOOD}


@pytest.mark.parametrize(
    ("now", "found", "said"),
    sampled(
        [
            (replace(THEN, seed=11), {}, ""),
            # Of the guard of 4 px that cells of 16 px leave, a third may be refitted.
            (replace(THEN, right_px=2.3), {"mask.place": REFIT}, "the mask moved"),
            (replace(THEN, albedo=0.81), {"lamp": REFIT}, "iris"),
            (replace(THEN, right_px=3.0), {"mask.place": BAD}, "the mask moved"),
            (
                replace(THEN, contrast=1.0 / (1.0 / CONTRAST + 0.0076)),
                {"mask.contrast": BAD},
                "polar",
            ),
            (replace(THEN, skew_s=SKEW_S + 1e-3), {"mask.skew_s": BAD}, "calibrate the timing"),
            (replace(THEN, skew_s=SKEW_S + T_S), {"mask.skew_s": BAD}, "+1 refresh(es) later"),
            (replace(THEN, camera_px=8.0), {"camera.place": BAD}, "the camera was bumped"),
            (replace(THEN, iso=200), {"settings": BAD}, "iso is 200, was 100"),
        ],
        3,
    ),
)
def test_what_changed_is_found_and_nothing_else(
    reference: Hands, tmp_path: Path, now: Truth, found: dict[str, Verdict], said: str
) -> None:
    outcome = later(reference, tmp_path, now).run_check()
    assert verdicts(outcome) == found
    assert said in " ".join(outcome.advice)
    assert outcome.picture is not None
    if BAD in found.values():
        assert not outcome.maps
        assert not outcome.words


@pytest.mark.long
def test_a_small_change_is_taken_into_account_once(reference: Hands, tmp_path: Path) -> None:
    turned = later(reference, tmp_path, replace(THEN, turn_deg=0.8, skew_s=SKEW_S + 3e-4))
    outcome = turned.run_check()
    assert verdicts(outcome) == {"mask.place": REFIT, "mask.skew_s": REFIT}
    assert all("taken into account" in text for text in outcome.advice)
    config = turned.session.config
    assert outcome.words["mask.skew_s"].value == pytest.approx(
        reference.session.config.mask.skew_s + 3e-4, abs=3e-5
    )
    true = panels_of(truth_of(turned.config).of(turned.config))
    points = np.random.default_rng(1).uniform(0.1, 0.9, (100, 2)) * config.mask.size_px
    wanted = between(true.mask.map, true.projector.map, points)
    got = between(turned.session.found("mask"), turned.session.found("projector"), points)
    assert np.quantile(np.hypot(*(got - wanted).T), 0.95) < 0.05
    assert verdicts(turned.run_check()) == {}


def test_without_a_timing_the_lag_is_left_out_and_said(reference: Hands, tmp_path: Path) -> None:
    one = later(reference, tmp_path, THEN)
    one.session.arrays = {
        key: value for key, value in one.session.arrays.items() if "timing" not in key
    }
    assert one.run_check().advice == (KEPT, NO_LAG)
    # As the next calibration gets to know it.
    write_arrays(tmp_path / "arrays.npz", one.session.arrays)
    one.session.arrays = read_arrays(tmp_path / "arrays.npz")
    outcome = one.run_check()
    assert outcome.advice == (NO_LAG,)
    assert "mask.skew_s" not in {figure.name for figure in outcome.figures}


def test_new_maps_ask_for_a_new_reference(reference: Hands, tmp_path: Path) -> None:
    one = later(reference, tmp_path, THEN)
    mask = one.session.config.mask
    moved = one.session.found("mask").then(np.array([[1, 0, 1e-4], [0, 1, 0], [0, 0, 1]]))
    mask = msgspec.structs.replace(mask, place=Placing(map=moved))
    one.session.config = msgspec.structs.replace(one.session.config, mask=mask)
    assert one.run_check().advice == (KEPT,)


def test_a_lens_cap_is_named(reference: Hands, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="no light"):
        later(reference, tmp_path, replace(THEN, albedo=1e-6)).run_check()
