"""Is the bench as it was calibrated? Five photos are compared with those taken right after it.

Without such photos, or where maps, times or contrasts were measured again since then, the snapshot
that is taken becomes the reference itself.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.check.changes import (
    DARKEST_MASK_SHARE,
    BenchSnapshot,
    CheckFinding,
    CheckResult,
    compare_snapshots,
)
from pdcd.calibration.check.look import (
    SnapshotExposure,
    pack_snapshot,
    take_snapshot,
    unpack_snapshot,
)
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.preview import ArrowField, draw_arrows, draw_text_lines
from pdcd.calibration.registration.registration_step import code_cell_px
from pdcd.calibration.script import CalibrationSession, ConfigValue, StepOutcome, StepScript
from pdcd.probing.cell_size import HALF, guard_px

_TAKEN = "taken into account; "
"""What advice on changes that were taken into account begins with."""
NO_LAG = (
    "the lag of the mask was not looked at: run pdcd calibrate timing, then pdcd calibrate "
    "check, which keeps a reference"
)
REFERENCE_KEPT = "this look is the reference for later checks: nothing was compared"
_AGAIN = "calibrate again before the next session: the bench has changed too much to allow for it"


def check_bench(session: CalibrationSession) -> StepScript:
    """White, the room, dots of both panels, and strips where the timing was measured.

    Small changes are taken into account: maps and lag are refitted. Larger ones are reported.
    Raises CalibrationError where the photos cannot be used at all.
    """
    before = unpack_snapshot(session.arrays, session.config.projector.size_px)
    exposure = SnapshotExposure(session.iso, session.f_number, session.full)
    if before is not None:
        iso, exposure = exposure.iso, before[1]
        if session.camera.isos and exposure.iso not in session.camera.isos:
            exposure = SnapshotExposure(iso, session.f_number, exposure.refreshes)
    now, said = yield from take_snapshot(session, exposure)
    said = said if now.lag_s is not None else NO_LAG
    if before is None:
        return StepOutcome(
            figures=(
                MeasuredFigure("check.dots", float(now.camera.count + now.mask.count), 0.0, ""),
                MeasuredFigure("check.closed", *now.closed, ""),
            ),
            arrays=pack_snapshot(now, exposure),
            advice=(REFERENCE_KEPT, said) if said else (REFERENCE_KEPT,),
        )
    found = compare_snapshots(
        now, before[0], guard_px(code_cell_px(session.on_field), HALF), session.refresh_s
    )
    return _compared(session, found, now, before[0], said)


def _compared(
    session: CalibrationSession,
    found: CheckResult,
    now: BenchSnapshot,
    then: BenchSnapshot,
    said: str,
) -> StepOutcome:
    """Figures, advice, and what is refitted."""
    refit, taken = StepOutcome(), frozenset[str]()
    if found.verdict is Verdict.DOUBTFUL:
        refit, taken = _refitted(session, found, now, then)
    advice = []
    for name, text in ((each.figure.name, each.advice) for each in found.findings):
        advice += [f"{name}: {_TAKEN * (name in taken)}{text}"] if text else []
    advice += [said] if said else []
    advice += [_AGAIN] if found.verdict is Verdict.BAD else []
    return replace(
        refit,
        figures=tuple(finding.figure for finding in found.findings),
        advice=tuple(advice),
        picture=lambda figure: _draw(figure, found, advice),
    )


def _refitted(
    session: CalibrationSession, found: CheckResult, now: BenchSnapshot, then: BenchSnapshot
) -> tuple[StepOutcome, frozenset[str]]:
    """Maps and configuration values corrected for small changes that were surely measured, and the
    names of these changes.

    Places and lag are measured relative to the calibration: once that is corrected, their reference
    stays valid. Light is absolute, so its reference is replaced.
    """
    changed: dict[str, CheckFinding] = {
        finding.figure.name: finding
        for finding in found.findings
        if finding.figure.verdict is Verdict.DOUBTFUL and finding.sure
    }
    config, light = session.config, session.config.camera.responsivity_e
    if then.closed[0] <= DARKEST_MASK_SHARE or config.mask.contrast is None:
        changed.pop("mask.contrast", None)
    if light is None:
        changed.pop("lamp", None)
    maps, words = {}, {}
    arrays: dict[str, NDArray[Any]] = {}
    if {"camera.place", "mask.place"} & changed.keys():
        for name, by in (("camera", found.camera), ("mask", found.mask)):
            maps[name] = session.found(name).then(by.of_field)
            words[f"{name}.place.map"] = ConfigValue("maps.npz")
    if "mask.skew_s" in changed:
        later = changed["mask.skew_s"].figure
        words["mask.skew_s"] = ConfigValue(config.mask.skew_s + later.value, later.sigma)
        arrays["timing.lag_s"] = session.arrays["timing.lag_s"] + later.value
    if "mask.contrast" in changed and config.mask.contrast is not None:
        more = 1.0 + changed["mask.contrast"].figure.value
        words["mask.contrast"] = ConfigValue(config.mask.contrast / more)
        arrays["check.closed"] = np.array(now.closed)
    if "lamp" in changed and light is not None:
        words["camera.responsivity_e"] = ConfigValue(tuple(each * found.lamp for each in light))
        arrays["check.white"] = now.white
    places = {f"{name}.place" for name in maps}
    return StepOutcome(words=words, maps=maps, arrays=arrays), frozenset(changed.keys() | places)


def _draw(figure: Any, found: CheckResult, advice: list[str]) -> None:
    """How camera and mask moved over the field, and what to do."""
    at = np.stack(np.meshgrid(*2 * [np.linspace(0.05, 0.95, 16)]), axis=-1).reshape(-1, 2)
    fields = []
    for name in ("camera", "mask"):
        by = getattr(found, name)
        points = at * by.size_px
        title = f"how the {name} moved, in projector pixels"
        fields.append(ArrowField(at, by(points) - points, title))
    draw_arrows(figure, fields, text_below=True)
    verdict = ("as it was", "a little changed: taken into account", "changed: calibrate again")
    lines = [f"the bench is {verdict[found.verdict]}; lamp {found.lamp:.1%}"]
    draw_text_lines(figure, [*lines, *(text[:118] for text in advice)])
