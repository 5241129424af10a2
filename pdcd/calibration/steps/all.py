"""All steps by name, in the order in which they are run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pdcd.calibration.metering import meter
from pdcd.calibration.script import Script, Session
from pdcd.calibration.steps.check import check_bench
from pdcd.calibration.steps.coaxial import coaxial
from pdcd.calibration.steps.focus import focus
from pdcd.calibration.steps.geometry import geometry
from pdcd.calibration.steps.light import light
from pdcd.calibration.steps.registration import registration
from pdcd.calibration.steps.response import response
from pdcd.calibration.steps.sensor import sensor
from pdcd.calibration.steps.shutter import shutter
from pdcd.calibration.steps.timing import timing


@dataclass(frozen=True)
class Step:
    """run : its script. text : what it finds out, in a few words. needs : steps without which it
    cannot be. card : whether it looks at a white card. usual : whether it is part of a whole
    calibration."""

    run: Callable[[Session], Script]
    text: str
    needs: tuple[str, ...] = ()
    card: bool = True
    usual: bool = True


STEPS: Mapping[str, Step] = MappingProxyType(
    {
        "sensor": Step(sensor, "black, gain, noise and upper end of the camera's sensor"),
        "light": Step(light, "contrasts, light of the room, brightness, lamp and lens"),
        "geometry": Step(geometry, "where projector, mask and camera lie"),
        "timing": Step(timing, "lag, rise and fall of both panels", ("geometry",)),
        "shutter": Step(shutter, "lag and jitter of the shutter", ("geometry", "timing")),
        "registration": Step(
            registration, "where light and mask meet, and how sharp", needs=("geometry",)
        ),
        "response": Step(response, "light of grey levels", needs=("geometry",), usual=False),
        "coaxial": Step(coaxial, "whether mask and projector look from one point", usual=False),
        "focus": Step(
            focus, "how sharp relay and projector are, while somebody focuses", usual=False
        ),
        "check": Step(check_bench, "whether all is as it was calibrated", needs=("geometry",)),
    }
)
METER = "meter"
"""What comes before all others."""


def script_of(name: str, session: Session) -> Script:
    """The script of a step, by name. Raises KeyError."""
    return meter(session) if name == METER else STEPS[name].run(session)


def ordered(names: tuple[str, ...]) -> tuple[str, ...]:
    """The steps in their order; all usual ones for none."""
    wanted = names or tuple(name for name, step in STEPS.items() if step.usual)
    return tuple(name for name in STEPS if name in wanted)
