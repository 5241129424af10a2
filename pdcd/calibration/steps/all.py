"""All steps by name, in the order in which they are run.

A step is imported when it is run: a daemon that takes photos all day shall not wait for what only a
calibration computes with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pdcd.calibration.script import Script, Session


@dataclass(frozen=True)
class Step:
    """One step.

    run : its script, "module:function" below this package.
    text : what it finds out, in a few words.
    needs : steps without which it cannot be.
    usual : whether it is part of a whole calibration.
    """

    run: str
    text: str
    needs: tuple[str, ...] = ()
    usual: bool = True


STEPS: Mapping[str, Step] = MappingProxyType(
    {
        "sensor": Step("sensor:sensor", "black, gain, noise and upper end of the camera's sensor"),
        "light": Step("light:light", "contrasts, light of the room, brightness, lamp and lens"),
        "geometry": Step("geometry:geometry", "where projector, mask and camera lie"),
        "timing": Step("timing:timing", "lag, rise and fall of both panels", ("geometry",)),
        "shutter": Step("shutter:shutter", "lag and jitter of the shutter", ("geometry", "timing")),
        "registration": Step(
            "registration:registration",
            "where light and mask meet, and how sharp",
            needs=("geometry",),
        ),
        "response": Step(
            "response:response", "light of grey levels", needs=("geometry",), usual=False
        ),
        "coaxial": Step(
            "coaxial:coaxial", "whether mask and projector look from one point", usual=False
        ),
        "focus": Step(
            "focus:focus", "how sharp relay and projector are, while somebody focuses", usual=False
        ),
        "check": Step(
            "check:check_bench", "whether all is as it was calibrated", needs=("geometry",)
        ),
    }
)
METER = "meter"
"""What comes before all others."""


def script_of(name: str, session: Session) -> Script:
    """The script of a step, by name. Raises KeyError."""
    module, _, function = (
        "pdcd.calibration.metering:meter" if name == METER else f"{__package__}.{STEPS[name].run}"
    ).partition(":")
    run: Callable[[Session], Script] = getattr(import_module(module), function)
    return run(session)


def ordered(names: tuple[str, ...]) -> tuple[str, ...]:
    """The steps in their order; all usual ones for none."""
    wanted = names or tuple(name for name, step in STEPS.items() if step.usual)
    return tuple(name for name in STEPS if name in wanted)
