"""The step of the shutter before a camera whose times are known: lags, advice, refusals."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.script import PhotoRequest
from pdcd.calibration.shutter.shutter_step import calibrate_shutter
from pdcd.errors import CalibrationError
from pdcd.panels.placing import Placing
from tests.unit.calibration.scripted import Run, preview_of, run, session_of
from tests.unit.calibration.test_shutter import (
    CAMERA,
    MASK,
    PROJECTOR,
    SIZE,
    START_S,
    TAUS,
    Camera,
    T,
    log,
)
from tests.unit.planning.test_measured import config

pytestmark = pytest.mark.whole

LAG_S = 0.06
SURE_S = config().trigger.sure_ns * 1e-9


class Bench:
    """Takes the photos that the step wants: opened and closed so much after it was told."""

    def __init__(self, opening_s: tuple[float, ...], closing_s: tuple[float, ...]) -> None:
        self._late = opening_s, closing_s
        self.photos: dict[str, QuadPhoto] = {}

    def taken(self, wanted: PhotoRequest) -> Any:
        name = wanted.shown.name
        if wanted.moving is None:
            camera = Camera(0.0, 0.0)
            self.photos[name] = camera.room() if name == "room" else camera.white()
            return SimpleNamespace(name=name)
        number = int(name.removeprefix("bar-")) - 1
        opening_s, closing_s = (late[number % len(late)] for late in self._late)
        told_s = START_S + wanted.moving.after * T
        close_s = told_s + SURE_S + wanted.moving.open_s
        camera = Camera(told_s + opening_s, close_s + closing_s, seed=number + 1)
        self.photos[name] = camera.photo(wanted.shown)
        return SimpleNamespace(
            name=name,
            log=log(wanted.shown.refreshes),
            open_ns=round((told_s + SURE_S) * 1e9),
            close_ns=round((close_s + SURE_S) * 1e9),
        )


def stepped(opening_s: tuple[float, ...], closing_s: tuple[float, ...] = ()) -> Run:
    """On a rig whose maps are known, and how its projector rises and falls."""
    bench = Bench(opening_s, closing_s or opening_s)
    tables = config(
        projector={
            "size_px": SIZE, "place": Placing(map=PROJECTOR), "rise_s": TAUS[0], "fall_s": TAUS[1],
        },
        mask={"size_px": MASK.size_px, "place": Placing(map=MASK)},
        camera={"place": Placing(map=CAMERA)},
        trigger={"lag_s": LAG_S},
    )  # fmt: skip
    session = session_of(tables, lambda taken: bench.photos[taken.name])  # type: ignore[attr-defined]
    session.full = 24
    session.arrays["timing.taus_s"] = np.array([*TAUS, *TAUS])
    session.arrays["timing.taus_sigma_s"] = 0.02 * np.array([*TAUS, *TAUS])
    return run(calibrate_shutter(session), bench.taken)


def test_one_lag_is_told_where_opening_and_closing_are_alike() -> None:
    out = stepped((0.052, 0.0522, 0.0518, 0.052, 0.0521)).outcome
    assert out is not None and not out.advice
    figures = {figure.name: figure for figure in out.figures}
    lag = figures["trigger.lag_s"]
    assert lag.value == pytest.approx(0.05202, abs=1.5e-4) and lag.verdict is Verdict.GOOD
    assert 0.0 < lag.sigma < 2e-4
    for name in ("shutter.opening_s", "shutter.closing_s"):
        assert figures[name].value == pytest.approx(0.05202, abs=2e-4)
    assert figures["trigger.jitter_s"].value < 5e-4
    for name in ("trigger.lag_s", "trigger.jitter_s"):
        word = out.words[name]
        assert (word.value, word.sigma) == (figures[name].value, figures[name].sigma)
    assert preview_of(out)[:4] == b"\x89PNG"


def test_the_longer_lag_counts_where_opening_and_closing_differ() -> None:
    for opening_s, closing_s in ((0.045, 0.058), (0.058, 0.045)):
        found = stepped((opening_s,), (closing_s,))
        out = found.outcome
        assert out is not None and len(out.advice) == 1
        told = [float(word) for word in re.findall(r"([0-9.]+) ms", out.advice[0])]
        assert told == pytest.approx([1e3 * opening_s, 1e3 * closing_s], abs=0.3)
        assert out.advice[0].endswith("trigger.lag_s is the longer of both")
        assert out.words["trigger.lag_s"].value == pytest.approx(0.058, abs=3e-4)
        figures = {figure.name: figure.value for figure in out.figures}
        assert figures["shutter.opening_s"] == pytest.approx(opening_s, abs=3e-4)
        assert figures["shutter.closing_s"] == pytest.approx(closing_s, abs=3e-4)


def test_a_lag_that_is_a_whole_cycle_off_is_refused() -> None:
    """In one of both bars half a second and more late looks like what was thought."""
    with pytest.raises(CalibrationError) as caught:
        stepped((LAG_S + 24 * T,))
    assert caught.value.device in ("shutter", "camera")
