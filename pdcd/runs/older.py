"""Manifests of earlier schemas, put into the words of today's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

from pdcd.errors import DecodeError
from pdcd.runs.record import SCHEMA_VERSION
from pdcd.words import FamilyName

GOAL = ("p", "shift", "radius", "mix", "period")
HOW = ("pilot", "parts", "repeat", "method", "black_level", "white")


def upgraded(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest, as JSON has it, in the present schema. Raises DecodeError for one of a schema
    that this version does not know."""
    schema = manifest.get("schema")
    if schema == SCHEMA_VERSION:
        return dict(manifest)
    if schema != 1:
        raise DecodeError(
            f"the manifest is of schema {schema!r}; this pdcd reads 1 to {SCHEMA_VERSION}",
            hint="decode the run with the version of pdcd that its manifest names",
        )
    run = manifest.get("run")
    plan = manifest.get("plan")
    if not isinstance(run, dict) or not isinstance(plan, dict):
        raise DecodeError("the manifest has no run or no plan", hint="restore it from a copy")
    return {**manifest, "schema": SCHEMA_VERSION, "run": _run_of_1(run, plan.get("family"))}


def _run_of_1(run: dict[str, Any], family: object) -> dict[str, Any]:
    """Schema 1 had goal and way of photographing in one flat table, codes without the pilot's, and
    took each cell for a block of pixels without saying so."""
    flat = ("goal", "codes", *GOAL, *HOW)
    how = {name: run[name] for name in HOW if name in run}
    how["codes"] = run.get("codes", 0) + run.get("pilot", 0)
    how["family"] = family if family in get_args(FamilyName) else None
    goal = {"name": run.get("goal"), **{name: run[name] for name in GOAL if name in run}}
    return {**{k: v for k, v in run.items() if k not in flat}, "goal": goal, "how": how}
