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
    """A manifest, as JSON has it, in the words of the present schema; `schema` still says which it
    was. Raises DecodeError for one that this version does not know."""
    schema = manifest.get("schema")
    if type(schema) is not int or not 1 <= schema <= SCHEMA_VERSION:
        raise DecodeError(
            f"the manifest is of schema {schema!r:.60}; this pdcd reads 1 to {SCHEMA_VERSION}",
            hint="decode the run with the version of pdcd that its manifest names",
        )
    if schema == SCHEMA_VERSION:
        return dict(manifest)
    return _of_2(_of_1(manifest) if schema == 1 else manifest)


def _of_2(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Schema 2 kept the SHA-256 of its files without their sizes, and had no digest beside it."""
    files = manifest.get("files")
    if not isinstance(files, dict):
        raise DecodeError("the manifest names no files", hint="restore it from a copy")
    kept = {name: {"sha256": digest, "size_bytes": None} for name, digest in files.items()}
    return {**manifest, "files": kept}


def _of_1(manifest: Mapping[str, Any]) -> dict[str, Any]:
    run = manifest.get("run")
    plan = manifest.get("plan")
    if not isinstance(run, dict) or not isinstance(plan, dict):
        raise DecodeError("the manifest has no run or no plan", hint="restore it from a copy")
    return {**manifest, "run": _run_of_1(run, plan.get("family"))}


def _run_of_1(run: dict[str, Any], family: object) -> dict[str, Any]:
    """Schema 1 had goal and way of photographing in one flat table, codes without the pilot's, and
    took each cell for a block of pixels without saying so."""
    flat = ("goal", "codes", *GOAL, *HOW)
    how = {name: run[name] for name in HOW if name in run}
    how["codes"] = run.get("codes", 0) + run.get("pilot", 0)
    how["family"] = family if family in get_args(FamilyName) else None
    goal = {"name": run.get("goal"), **{name: run[name] for name in GOAL if name in run}}
    return {**{k: v for k, v in run.items() if k not in flat}, "goal": goal, "how": how}
