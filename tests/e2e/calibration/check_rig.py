"""A bench that was calibrated, and the same bench some days later."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np

from pdcd.bench.tables import PanelConfig, SceneConfig
from pdcd.calibration.check.check_step import REFERENCE_KEPT, check_bench
from pdcd.calibration.figures import Verdict
from pdcd.calibration.script import StepOutcome
from pdcd.capture.worker.calibrating import read_arrays, write_arrays
from pdcd.panels.placing import Placing
from tests.e2e.calibration.hands import Hands
from tests.e2e.calibration.steps_rig import MASK_PX, make_config

SKEW_S, CONTRAST = 3.7e-3, 450.0
T_S = 1.0 / 60.0


@dataclass(frozen=True)
class Truth:
    """What of the bench changes from one look to the next."""

    skew_s: float = SKEW_S
    closed: float = 1.0 / CONTRAST
    right_px: float = 1.3
    turn_deg: float = 0.7
    camera_px: float = 2.0
    albedo: float = 0.9
    ambient: float = 0.0
    iso: int = 100
    seed: int = 3

    def hands(self, folder: Path) -> Hands:
        """The bench as it is, believed to be as in the data sheets."""
        truth = f"""
            [projector]
            contrast = 900.0
            falloff = 0.3
            rise_s = 0.0031
            fall_s = 0.0022
            [mask]
            contrast = {1.0 / self.closed}
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
            [scene]
            ambient = {self.ambient}
            """
        config = make_config(
            folder, truth, quads=(300, 216), camera={"seed": self.seed, "iso": self.iso},
            mask=PanelConfig(size_px=MASK_PX, contrast=CONTRAST),
            scene=SceneConfig(kind="card", grid=(12, 16), options={"albedo": self.albedo}),
        )  # fmt: skip
        return Hands(config, folder, full=80, f_number=22.0)


@dataclass(frozen=True)
class Change:
    """What is different of a bench, by how much, and what a check must then say.

    found : figures that are not good, and what of them; nothing where nothing changed. said : a
    part of the advice.
    """

    name: str
    by: Mapping[str, float]
    found: Mapping[str, Verdict] = field(default_factory=dict)
    said: str = ""

    def of(self, truth: Truth) -> Truth:
        """The bench after the change."""
        return replace(truth, **{name: getattr(truth, name) + by for name, by in self.by.items()})


_REFIT, _BAD = Verdict.DOUBTFUL, Verdict.BAD

CHANGES = (
    # Of the guard of 4 px that cells of 16 px leave, a third may be refitted.
    Change("mask shifted by 1 px", {"right_px": 1.0}, {"mask.place": _REFIT}, "the mask moved"),
    Change("mask shifted by 1.7 px", {"right_px": 1.7}, {"mask.place": _BAD}, "the mask moved"),
    Change("mask turned by 0.1 degree", {"turn_deg": 0.1}, {"mask.place": _REFIT}, "taken into"),
    Change("lamp 10 % darker", {"albedo": -0.09}, {"lamp": _REFIT}, "iris"),
    Change("room lit by 5 % of white", {"ambient": 0.045}),
    Change("polariser 5 degrees off", {"closed": 0.0076}, {"mask.contrast": _BAD}, "polar"),
    Change("mask 1 ms later", {"skew_s": 1e-3}, {"mask.skew_s": _BAD}, "calibrate the timing"),
    Change("mask a refresh later", {"skew_s": T_S}, {"mask.skew_s": _BAD}, "+1 refresh(es) later"),
    Change("camera bumped", {"camera_px": 6.0}, {"camera.place": _BAD}, "the camera was bumped"),
    Change("another ISO", {"iso": 100}, {"settings": _BAD}, "iso is 200 and was 100"),
)


def calibrated(truth: Truth, folder: Path) -> Hands:
    """A bench that was calibrated, with its look right after."""
    one = truth.hands(folder)
    one.knows_maps()
    one.session.arrays |= {
        "timing.lag_s": np.full(2, SKEW_S),
        # Some per cent wrong, as times that were measured are.
        "timing.taus_s": np.array([3.2e-3, 2.1e-3, 4.4e-3, 7.3e-3]),
        "timing.leaks": np.array([0.0, 1.0 / CONTRAST]),
    }
    outcome = one.run("check", check_bench(one.session))
    assert outcome.advice == (REFERENCE_KEPT,)
    assert one.photos == 5
    return one


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


def verdicts(outcome: StepOutcome) -> dict[str, Verdict]:
    """Figures of a check that are not good."""
    return {f.name: f.verdict for f in outcome.figures if f.verdict is not Verdict.GOOD}
