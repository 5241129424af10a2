"""Settings of an EOS body in photographers' terms, from the codes that it lists."""

from __future__ import annotations

from collections.abc import Mapping

from .codes import (
    APERTURE_CODES,
    CUSTOM_LONG_EXPOSURE_NR,
    ISO_CODES,
    ExposureMode,
    FocusMode,
    Property,
)

_BATTERY_EMPTY = 0
"""`Property.BATTERY` when the camera is about to switch itself off (others: 1 half, 2 full)."""


def list_isos(codes: tuple[int, ...]) -> dict[int, int]:
    """ISO -> code for the listed codes, ascending; the automatic one is left out."""
    named = ((ISO_CODES.get(code, 0), code) for code in codes)
    return dict(sorted((iso, code) for iso, code in named if iso))


def list_f_numbers(codes: tuple[int, ...]) -> dict[float, int]:
    """f-number -> code for the listed codes, ascending; empty for a lens without contacts."""
    found: dict[float, int] = {}
    for code in codes:
        if code in APERTURE_CODES:
            found.setdefault(APERTURE_CODES[code], code)
    return dict(sorted(found.items()))


def list_setup_faults(
    values: Mapping[int, int], custom: Mapping[int, int], destination: str
) -> list[str]:
    """What must be changed on the camera before it can hold an exposure; empty if nothing must.

    values, custom : properties and custom functions as reported so far; those not reported are not
    judged. destination : "ram" or "card".
    """
    mode = values.get(Property.EXPOSURE_MODE, ExposureMode.MANUAL)
    focus = values.get(Property.FOCUS_MODE, FocusMode.MANUAL)
    on_card = destination == "card"
    place = "on the card: change it" if on_card else "in the camera: switch it off and on"
    faults = {
        "the mode dial is not on M: turn it there": mode
        not in (ExposureMode.MANUAL, ExposureMode.BULB),
        "autofocus is on: set the lens to MF": focus != FocusMode.MANUAL,
        "the battery is empty: charge it": values.get(Property.BATTERY) == _BATTERY_EMPTY,
        "long-exposure noise reduction is on, which takes a second, dark exposure: switch it "
        "off in the custom functions": bool(custom.get(CUSTOM_LONG_EXPOSURE_NR)),
        f"there is no room {place}": values.get(Property.AVAILABLE_SHOTS) == 0,
    }
    return [fault for fault, holds in faults.items() if holds]
