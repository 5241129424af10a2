"""Runs the script of a step before a camera that is made up, and keeps what was asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.preview import write_step_preview
from pdcd.calibration.script import (
    CalibrationSession,
    PhotoRequest,
    StepOutcome,
    StepScript,
    UserPrompt,
)
from pdcd.sensor.profile import load_profile

STOPS = tuple(round(2.0 ** (k / 6.0), 3) for k in range(6, 49))


@dataclass
class Answered(CalibrationSession):
    """A session whose photos are what `answer` gives for what was wanted."""

    answer: Callable[[PhotoRequest], QuadPhoto] | None = None

    def photo(self, taken: Any) -> QuadPhoto:
        """The photo of what was wanted."""
        assert self.answer is not None
        return self.answer(taken)


def session_of(
    config: Config | None = None,
    answer: Callable[[PhotoRequest], QuadPhoto] | None = None,
    f_numbers: tuple[float, ...] = STOPS,
) -> Answered:
    """A session of a camera with these apertures."""
    camera = CameraInfo("", "", "450d", np.ones(3), (100,), f_numbers)
    return Answered(config or Config(), load_profile("450d"), camera, 100, answer=answer)


@dataclass
class Run:
    """What a script asked for, and what it found."""

    wanted: list[PhotoRequest] = field(default_factory=list)
    asked: list[UserPrompt] = field(default_factory=list)
    outcome: StepOutcome | None = None


def run(script: StepScript, taken: Callable[[PhotoRequest], Any] = lambda wanted: wanted) -> Run:
    """Send a script what `taken` makes of each photo it wants, to its end."""
    found = Run()
    try:
        asked = next(script)
        while True:
            if isinstance(asked, UserPrompt):
                found.asked.append(asked)
                asked = script.send(None)
            else:
                found.wanted.append(asked)
                asked = script.send(taken(asked))
    except StopIteration as end:
        found.outcome = end.value
    return found


def preview_of(outcome: StepOutcome) -> bytes:
    """The PNG file that a step's preview makes."""
    assert outcome.picture is not None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "preview.png"
        write_step_preview(path, outcome.picture)
        return path.read_bytes()
