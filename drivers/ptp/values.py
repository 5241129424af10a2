"""Settings of an EOS body as people know them, from the codes it lists."""

from __future__ import annotations

from drivers.ptp.codes import APERTURE_CODES, ISO_CODES

BATTERY_EMPTY = 0
"""`Property.BATTERY` when the camera is about to switch itself off (others: 1 half, 2 full)."""


def isos(codes: tuple[int, ...]) -> dict[int, int]:
    """ISO -> code of those listed, ascending; the automatic one is left out."""
    named = ((ISO_CODES.get(code, 0), code) for code in codes)
    return dict(sorted((iso, code) for iso, code in named if iso))


def f_numbers(codes: tuple[int, ...]) -> dict[float, int]:
    """f-number -> code of those listed, ascending; empty for a lens without contacts."""
    found: dict[float, int] = {}
    for code in codes:
        if code in APERTURE_CODES:
            found.setdefault(APERTURE_CODES[code], code)
    return dict(sorted(found.items()))
