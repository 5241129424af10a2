"""Is the bench as it was calibrated? Five photos, held against those taken right after it.

Without such photos, or where maps, times or contrasts were measured anew since, the look that is
taken becomes the reference itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.check.changes import (
    DARKEST,
    GOOD_CLOSED,
    GOOD_LAMP,
    GOOD_PX,
    GOOD_S,
    Checked,
    Look,
    check,
    matched,
)
from pdcd.calibration.check.look import (
    PANELS,
    Exposure,
    Seen,
    as_it_lies,
    by_maps,
    fingerprint,
    kept,
    look,
    reference,
)
from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.preview import draw_arrows, write_lines
from pdcd.calibration.registration.correction import bent_to, nodes_of
from pdcd.calibration.registration.registration_step import cell_px
from pdcd.calibration.script import Measured, Outcome, Script, Session
from pdcd.calibration.timing.skew_change import skew_change
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, between
from pdcd.probing.cell_size import HALF, guard_px

Floats = NDArray[np.float64]

TAKEN = "taken into account; "
"""What `pdcd.calibration.check.changes` begins the advice on small changes with."""
SURE = {
    "mask.place": GOOD_PX, "camera.place": GOOD_PX, "mask.skew_s": GOOD_S, "lamp": GOOD_LAMP,
    "mask.contrast": GOOD_CLOSED, "settings": 0.0,
}  # fmt: skip
"""Errors from which on a change is not taken into account."""
WORDS = {
    "mask.place": "mask.place.map",
    "camera.place": "camera.place.map",
    "lamp": "camera.responsivity_e",
}
"""Words of the figures that have others."""
NO_LAG = (
    "the lag of the mask was not looked at: run pdcd calibrate timing, then check for a reference"
)
KEPT = "this look is the reference for checks to come: nothing was compared"
AGAIN = "calibrate anew before the next session: what was found is more than can be allowed for"


@dataclass(frozen=True, eq=False)
class _Before:
    """The reference, how it was taken, and what its strips left of the model."""

    then: Look
    exposure: Exposure
    strips: Floats


def check_bench(session: Session) -> Script:
    """White, the room, dots of both panels, and strips where the timing was measured.

    What has changed a little is taken into account: maps and lag are refitted. What has changed
    more is said. Raises CalibrationError where photos say nothing at all.
    """
    calibrated = fingerprint(session)
    before = _before(session, calibrated)
    if before is None:
        exposure = Exposure(session.iso, session.f_number, session.full)
        seen = yield from look(session, exposure, by_maps(session))
        return _first(seen, exposure, calibrated)
    then, exposure = before.then, before.exposure
    if session.camera.isos and exposure.iso not in session.camera.isos:
        exposure = Exposure(session.iso, exposure.f_number, exposure.refreshes)
    seen = yield from look(session, exposure, {panel: getattr(then, panel) for panel in PANELS})
    now, said = _with_lag(seen, then, before.strips, session.refresh_s)
    found = check(
        now, then, session.found("camera"), session.found("projector"),
        guard_px(cell_px(session.on_field), HALF), session.refresh_s,
    )  # fmt: skip
    return _compared(session, seen, now, before, found, said)


def _before(session: Session, calibrated: Floats) -> _Before | None:
    """The reference, where there is one of this calibration."""
    try:
        then, exposure, strips, belongs = reference(session.arrays)
    except KeyError:
        return None
    same = belongs.shape == calibrated.shape and np.allclose(belongs, calibrated, rtol=1e-9)
    return _Before(then, exposure, strips) if same else None


def _first(seen: Seen, exposure: Exposure, calibrated: Floats) -> Outcome:
    """A reference, and no verdict."""
    now = seen.look
    advice = (KEPT,) if seen.strips is not None else (KEPT, NO_LAG)
    return Outcome(
        figures=(
            Figure("check.dots", float(len(now.projector.index) + len(now.mask.index)), 0.0, ""),
            Figure("check.closed", *now.closed, ""),
        ),
        arrays=kept(seen, exposure, calibrated),
        advice=advice,
    )


def _with_lag(seen: Seen, then: Look, strips: Floats, refresh_s: float) -> tuple[Look, str]:
    """The look with the change of its lag, and what to say where it cannot be told."""
    now = seen.look
    if seen.strips is None or strips.shape[1] != seen.strips.value.size:
        return now, NO_LAG
    value, sigma = seen.strips.value, np.hypot(seen.strips.sigma, strips[1])
    # A mask that leaks more lights the strips, too, and is told by its own figure.
    model = seen.strips.model.leaking(now.closed[0] - then.closed[0])
    try:
        change = skew_change(value, model(0.0) + strips[0], sigma, model, 0.0, refresh_s)
    except CalibrationError as err:
        change, said = (np.nan, np.nan), f"{err.message}: {err.hint}"
    else:
        said = ""
    return replace(now, skew_s=change), said


def _compared(
    session: Session, seen: Seen, now: Look, before: _Before, found: Checked, said: str
) -> Outcome:
    """Figures, advice, and what is refitted."""
    findings = [f for f in found.findings if said != NO_LAG or f.figure.name != "mask.skew_s"]
    figures = tuple(finding.figure for finding in findings)
    verdict = max(figure.verdict for figure in figures)
    refit = Outcome()
    if verdict is Verdict.DOUBTFUL:
        refit = _refitted(session, seen, now, before, found, figures)
    advice = []
    for finding in findings:
        text = finding.advice
        if text.startswith(TAKEN) and not _covers(refit, finding.figure.name):
            text = text.removeprefix(TAKEN)
        advice += [f"{finding.figure.name}: {text}"] if text else []
    advice += [said] if said else []
    advice += [AGAIN] if verdict is Verdict.BAD else []
    return replace(
        refit,
        figures=figures,
        advice=tuple(advice),
        picture=lambda figure: _draw(figure, session, now, before.then, found, advice),
    )


def _covers(refit: Outcome, name: str) -> bool:
    """Whether a figure is among what was refitted."""
    return WORDS.get(name, name) in refit.words


def _refitted(
    session: Session,
    seen: Seen,
    now: Look,
    before: _Before,
    found: Checked,
    figures: tuple[Figure, ...],
) -> Outcome:
    """Maps and words with what has changed a little and was surely measured, and a reference that
    knows of it: else the next check would take it into account once more."""
    changed = {
        f.name: f for f in figures if f.verdict is Verdict.DOUBTFUL and f.sigma < SURE[f.name]
    }
    config, then = session.config, before.then
    maps = _moved(session, found) if {"camera.place", "mask.place"} & changed.keys() else {}
    words = {f"{name}.place.map": Measured("maps.npz") for name in maps}
    arrays: dict[str, NDArray[Any]] = {}
    kept_now = replace(then, projector=now.projector, mask=now.mask) if maps else then
    later_s: float = 0.0
    strips: Floats | None = before.strips
    if lag := changed.get("mask.skew_s"):
        words["mask.skew_s"] = Measured(config.mask.skew_s + lag.value, lag.sigma)
        arrays["timing.lag_s"] = session.arrays["timing.lag_s"] + lag.value
        later_s, strips = lag.value, None
    seen_black = then.closed[0] > DARKEST
    if (closed := changed.get("mask.contrast")) and seen_black and config.mask.contrast is not None:
        words["mask.contrast"] = Measured(config.mask.contrast / (1.0 + closed.value))
        kept_now = replace(kept_now, closed=now.closed)
    light = config.camera.responsivity_e
    if "lamp" in changed and light is not None:
        words["camera.responsivity_e"] = Measured(tuple(each * found.lamp for each in light))
        kept_now = replace(kept_now, white=now.white)
    refit = Outcome(words=words, maps=maps, arrays=arrays)
    after = replace(session, arrays=dict(session.arrays), done=[])
    after.learn("check", refit)
    arrays |= kept(replace(seen, look=kept_now), before.exposure, fingerprint(after), later_s)
    if strips is not None:
        arrays["check.strips"] = strips
    return refit


def _moved(session: Session, found: Checked) -> dict[str, Map]:
    """Maps of camera and mask as they lie now."""
    camera, projector, mask = (session.found(name) for name in ("camera", "projector", "mask"))

    def on_projector(points_px: Floats) -> Floats:
        moved = found.mask(between(mask, projector, points_px))
        return projector.to_field(moved)

    return {
        "camera": as_it_lies(camera, found.camera),
        "mask": bent_to(mask, on_projector, nodes_of(mask), "mask"),
    }


def _draw(
    figure: Any, session: Session, now: Look, then: Look, found: Checked, advice: list[str]
) -> None:
    """How the dots of both panels moved in the photo, and what to do."""
    size = np.array(session.found("camera").size_px, dtype=np.float64)
    for axes, panel in zip(figure.subplots(1, 2), PANELS, strict=True):
        was, is_now, _ = matched(getattr(now, panel), getattr(then, panel))
        title = f"how the {panel}'s dots moved in the photo"
        draw_arrows(axes, was / size, is_now - was, title, unit="quads")
    verdict = ("as it was", "a little changed: taken into account", "changed: calibrate anew")
    lines = [f"the bench is {verdict[found.verdict]}; lamp {found.lamp:.1%}"]
    write_lines(figure, [*lines, *(text[:118] for text in advice)])
