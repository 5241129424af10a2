"""All cases, by subject."""

from __future__ import annotations

from importlib import import_module

from tests.goldens.case import Case

ROOMS = ("goals", "ways", "benches", "calibrations", "commands", "devices", "daemon")


def all_cases() -> list[Case]:
    """Every case, in the order of the rooms."""
    found: list[Case] = []
    for room in ROOMS:
        found += import_module(f"{__name__}.{room}").cases()
    names = [case.name for case in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"two cases share a name: {', '.join(twice)}")
    return found
