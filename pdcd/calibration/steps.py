"""All steps by name, in the order in which they are run.

A step is imported when it is run: a daemon that takes photos all day shall not wait for what only a
calibration computes with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

from pdcd.words import SubjectName

if TYPE_CHECKING:
    from pdcd.calibration.script import Script, Session


STEPS: Mapping[str, str] = MappingProxyType(
    {
        "sensor": "sensor.sensor_step:sensor",
        "light": "light.light_step:light",
        "geometry": "geometry.geometry_step:geometry",
        "timing": "timing.timing_step:timing",
        "shutter": "shutter.shutter_step:shutter",
        "registration": "registration.registration_step:registration",
        "response": "response.response_step:response",
        "coaxial": "geometry.coaxial_step:coaxial",
        "focus": "registration.focus_step:focus",
        "disparity": "geometry.disparity_step:disparity",
        "check": "check.check_step:check_bench",
    }
)
"""Each step's script, "module:function" below this package; docs/calibration.md tells of them."""
AT_WISH = frozenset({"response", "coaxial", "focus", "disparity"})
"""Steps that are no part of a whole calibration."""
BY_HAND = frozenset({"coaxial"})
"""Steps that tell nothing unless somebody does what they ask."""
METER = "meter"
"""What comes before all others."""


def script_of(name: str, session: Session) -> Script:
    """The script of a step, by name. Raises KeyError."""
    module, _, function = (
        "pdcd.calibration.light.metering:meter" if name == METER else f"{__package__}.{STEPS[name]}"
    ).partition(":")
    run: Callable[[Session], Script] = getattr(import_module(module), function)
    return run(session)


def ordered(names: tuple[str, ...], subject: SubjectName = "card") -> tuple[str, ...]:
    """The steps in their order; for none all but those `AT_WISH`, and on a scene the geometry."""
    if not names and subject == "scene":
        names = ("geometry",)
    return tuple(name for name in STEPS if name in (names or STEPS.keys() - AT_WISH))
