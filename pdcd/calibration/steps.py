"""All steps by name, in the order in which they are run.

A step is imported only when it is run: a daemon that takes photos all day should not wait for what
only a calibration computes with.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

from pdcd.words import SubjectName

if TYPE_CHECKING:
    from pdcd.calibration.script import CalibrationSession, StepScript


STEP_SCRIPTS: Mapping[str, str] = MappingProxyType(
    {
        "sensor": "sensor.sensor_step:calibrate_sensor",
        "light": "light.light_step:calibrate_light",
        "geometry": "geometry.geometry_step:calibrate_geometry",
        "timing": "timing.timing_step:calibrate_timing",
        "shutter": "shutter.shutter_step:calibrate_shutter",
        "registration": "registration.registration_step:calibrate_registration",
        "response": "response.response_step:calibrate_response",
        "focus": "registration.focus_step:watch_focus",
        "disparity": "geometry.disparity_step:calibrate_disparity",
        "check": "check.check_step:check_bench",
    }
)
"""Each step's script, "module:function" below this package; docs/calibration.md describes them."""
AT_WISH = frozenset({"response", "focus", "disparity"})
"""Steps that are not part of a whole calibration."""
_BY_BLOCKS = frozenset({"sensor", "light"})
"""Steps that use blocks of a photo."""
METER = "meter"
"""The step before all others."""
GOES_BY: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "light": frozenset({"sensor"}),
        "timing": frozenset({"geometry"}),
        "shutter": frozenset({"geometry", "timing"}),
        "registration": frozenset({"geometry", "timing"}),
        "response": frozenset({"geometry"}),
        "disparity": frozenset({"geometry"}),
        "check": frozenset({"geometry", "timing"}),
    }
)
"""Steps whose results each step depends on: where theirs are bad, its own are not used."""
STALE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "geometry": ("rig.misregistration_px",),
        "sensor": ("camera.responsivity_e",),
    }
)
"""Values of other steps that a new result of a step invalidates: the offset that remained between
the maps once they were corrected, and light in electrons by a gain that has been measured again.
What a panel, a shutter or a lens does by itself stays true wherever it was seen."""


def start_step_script(name: str, session: CalibrationSession) -> StepScript:
    """The script of a step, by name. Raises KeyError."""
    module, _, function = (
        "pdcd.calibration.light.metering:meter_light"
        if name == METER
        else f"{__package__}.{STEP_SCRIPTS[name]}"
    ).partition(":")
    run: Callable[[CalibrationSession], StepScript] = getattr(import_module(module), function)
    return run(session)


def check_frame_size(
    names: Collection[str], session: CalibrationSession, frame: tuple[int, int]
) -> None:
    """Raise CalibrationError where photos of so many rows and columns of quads are too small for
    one of these steps. It is called before photos are taken."""
    from pdcd.calibration.geometry.geometry_step import check_dots_in_frame
    from pdcd.calibration.photo import check_blocks_in_frame

    if not _BY_BLOCKS.isdisjoint(names):
        check_blocks_in_frame(frame)
    if "geometry" in names:
        check_dots_in_frame(session, frame)


def explain_unused_step(step: str, left_out: Collection[str]) -> str:
    """Why the values of a good step are not used, given that those of others are not; "" where they
    are used.

    left_out : steps of the same calibration whose values are not used.
    """
    through = [name for name in STEP_SCRIPTS if name in GOES_BY.get(step, ()) and name in left_out]
    return f"it goes by {' and '.join(through)}" if through else ""


def order_steps(names: tuple[str, ...], subject: SubjectName = "card") -> tuple[str, ...]:
    """The steps in their order; without names all but those `AT_WISH`, and on a scene the
    geometry."""
    if not names and subject == "scene":
        names = ("geometry",)
    return tuple(name for name in STEP_SCRIPTS if name in (names or STEP_SCRIPTS.keys() - AT_WISH))
