"""Is the bench as it was calibrated? Four photos, held against those taken right after it.

Without such photos, or where maps, times or contrasts were measured anew since, the look that is
taken becomes the reference itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration import sketch
from pdcd.calibration.cell_size import HALF, guard_px
from pdcd.calibration.check import GOOD_CLOSED, GOOD_LAMP, GOOD_S, Checked, Look, check
from pdcd.calibration.correction import bent_to
from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.look import (
    PANELS,
    Exposure,
    Seen,
    by_maps,
    fingerprint,
    kept,
    look,
    reference,
)
from pdcd.calibration.script import Measured, Outcome, Script, Session
from pdcd.calibration.skew_change import skew_change
from pdcd.calibration.steps.registration import cell_px
from pdcd.errors import CalibrationError
from pdcd.maps.map import Map, between

Floats = NDArray[np.float64]

NODES = (8, 10)
"""Rows and columns of the residual of a refitted map, at least."""
NO_LAG = (
    "the lag of the mask was not looked at: run pdcd calibrate timing, then check for a reference"
)
KEPT = "this look is the reference for checks to come: nothing was compared"
AGAIN = "calibrate anew before the next session: what was found is more than can be allowed for"


def check_bench(session: Session) -> Script:
    """White, dots of both panels, and strips where the timing was measured.

    What has changed a little is taken into account: maps and lag are refitted. What has changed
    more is said. Raises CalibrationError where photos say nothing at all.
    """
    calibrated = fingerprint(session)
    before = _before(session, calibrated)
    if before is None:
        exposure = Exposure(session.iso, session.f_number, session.full)
        seen = yield from look(session, exposure, by_maps(session))
        return _first(seen, exposure, calibrated)
    then, exposure, strips = before
    if session.camera.isos and exposure.iso not in session.camera.isos:
        exposure = Exposure(session.iso, exposure.f_number, exposure.refreshes)
    seen = yield from look(session, exposure, {panel: getattr(then, panel) for panel in PANELS})
    now, said = _with_lag(seen, then, strips, session.refresh_s)
    found = check(
        now, then, session.found("camera"), session.found("projector"),
        guard_px(cell_px(session.config), HALF), session.refresh_s,
    )  # fmt: skip
    return _compared(session, Seen(now, seen.strips, seen.sigma, seen.model), then, found, said)


def _before(session: Session, calibrated: Floats) -> tuple[Look, Exposure, Floats] | None:
    """The reference, where there is one of this calibration."""
    try:
        then, exposure, strips, belongs = reference(session.arrays)
    except KeyError:
        return None
    same = belongs.shape == calibrated.shape and np.allclose(belongs, calibrated, rtol=1e-9)
    return (then, exposure, strips) if same else None


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
    if seen.strips is None or seen.model is None or seen.sigma is None:
        return now, NO_LAG
    if strips.shape[1] != seen.strips.size:
        return now, NO_LAG
    left, sigma_then = strips
    # A mask that leaks more lights the strips, too, and is told by its own figure.
    model = seen.model.leaking(now.closed[0] - then.closed[0])
    try:
        change = skew_change(
            seen.strips, model(0.0) + left, np.hypot(seen.sigma, sigma_then), model, 0.0, refresh_s
        )
    except CalibrationError as err:
        change, said = (np.nan, np.nan), f"{err.message}: {err.hint}"
    else:
        said = ""
    looked = Look(
        now.projector, now.mask, now.white, now.closed, change, now.settings, now.saturated
    )
    return looked, said


def _compared(session: Session, seen: Seen, then: Look, found: Checked, said: str) -> Outcome:
    """Figures, advice, and what is refitted."""
    findings = [f for f in found.findings if said != NO_LAG or f.figure.name != "mask.skew_s"]
    advice = [f"{f.figure.name}: {f.advice}" for f in findings if f.advice]
    advice += [said] if said else []
    figures = tuple(finding.figure for finding in findings)
    verdict = max(figure.verdict for figure in figures)
    maps: dict[str, Map] = {}
    words: dict[str, Measured] = {}
    arrays: Mapping[str, NDArray[Any]] = {}
    if verdict is Verdict.BAD:
        advice.append(AGAIN)
    elif verdict is Verdict.DOUBTFUL:
        maps, words, arrays = _refitted(session, found, figures)
    return Outcome(
        figures=figures,
        words=words,
        maps=maps,
        arrays=arrays,
        advice=tuple(advice),
        picture=_picture(session, seen.look, then, found, advice),
    )


def _refitted(
    session: Session, found: Checked, figures: tuple[Figure, ...]
) -> tuple[dict[str, Map], dict[str, Measured], dict[str, NDArray[Any]]]:
    """Maps and words with what has changed a little, of each thing that was surely measured."""
    changed = {f.name: f for f in figures if f.verdict is Verdict.DOUBTFUL}
    config, maps = session.config, {}
    words: dict[str, Measured] = {}
    arrays: dict[str, NDArray[Any]] = {}
    camera, projector, mask = (session.found(name) for name in ("camera", "projector", "mask"))
    if "camera.place" in changed:
        maps["camera"] = bent_to(
            camera, lambda at: camera.to_field(found.camera.back(at)), _nodes(camera), "camera"
        )
    if "mask.place" in changed:
        maps["mask"] = bent_to(
            mask,
            lambda at: projector.to_field(found.mask(between(mask, projector, at))),
            _nodes(mask),
            "mask",
        )
    words |= {f"{name}.place.map": Measured("maps.npz") for name in maps}
    lag = changed.get("mask.skew_s")
    if lag is not None and lag.sigma < GOOD_S:
        words["mask.skew_s"] = Measured(config.mask.skew_s + lag.value, lag.sigma)
        arrays["timing.lag_s"] = session.arrays["timing.lag_s"] + lag.value
    closed = changed.get("mask.contrast")
    if closed is not None and config.mask.contrast is not None and closed.sigma < GOOD_CLOSED:
        words["mask.contrast"] = Measured(config.mask.contrast / (1.0 + closed.value))
    lamp, light = changed.get("lamp"), config.camera.responsivity_e
    if lamp is not None and light is not None and lamp.sigma < GOOD_LAMP:
        words["camera.responsivity_e"] = Measured(tuple(each * found.lamp for each in light))
    return maps, words, arrays


def _nodes(map_: Map) -> tuple[int, int]:
    """Rows and columns of a map's residual; `NODES` for one without."""
    shape = np.shape(map_.residual)[:2] if map_.residual else NODES
    return int(shape[0]), int(shape[1])


def _picture(
    session: Session, now: Look, then: Look, found: Checked, advice: list[str]
) -> NDArray[np.uint8]:
    """How the dots of both panels moved in the photo, and what to do."""
    picture = sketch.blank()
    width, height = session.found("camera").size_px
    box_height = min(round(420 * height / width), 340)
    for number, panel in enumerate(PANELS):
        after, before = getattr(now, panel), getattr(then, panel)
        place = {tuple(at): n for n, at in enumerate(before.index.tolist())}
        both = [
            (n, place[tuple(at)]) for n, at in enumerate(after.index.tolist()) if tuple(at) in place
        ]
        one, two = np.array(both).T
        moved = after.quads[one] - before.quads[two]
        box = (20 + 440 * number, 40, 420, box_height)
        title = f"how the {panel}'s dots moved in the photo"
        sketch.arrows(picture, box, before.quads[two] / (width, height), moved, title, unit="quads")
    verdict = ("as it was", "a little changed: taken into account", "changed: calibrate anew")
    lines = [f"the bench is {verdict[found.verdict]}; lamp {found.lamp:.1%}"]
    sketch.write(picture, [*lines, *(text[:118] for text in advice)], 20, box_height + 75)
    return picture
