"""`pdcd compare`: one goal by every method on the same rig and scene, side by side."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from pdcd.cli.capture import capture_photo
from pdcd.cli.daemon import refuse_with_local
from pdcd.cli.exits import DONE
from pdcd.cli.output import say, say_json, say_notes, say_result, say_table
from pdcd.cli.request import collect_array_files, parse_request_options
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, quality_of, read_summary_value
from pdcd.words import MethodName

_COMPARED: tuple[MethodName, ...] = ("coded", "multi-image", "nayar")
"""Methods that differ in more than how light is gathered."""


_FIGURES = {
    "codes": ("codes", "codes", ""),
    "raw_files": ("shots", "RAW files", ""),
    "exposure_s": ("exposure_s", "exposure", " s"),
    "rms_error_quads": ("rms_error_quads", "RMS error", " %"),
    "rms_error_cells": ("rms_error_cells", "", ""),
    "sigma_mean": ("sigma_mean", "mean sigma", ""),
    "wall_s": ("wall_s", "wall time", " s"),
}
"""Figures of each method, by their names in JSON: key of the run's summary, head of the column if
there is one, and unit. `codes` is None where a method does not choose codes; `raw_files` excludes
test exposures; errors are relative to the scene's truth, None where that is not known; `sigma_mean`
is in scene units."""


def compare(args: argparse.Namespace) -> int:
    """Take the photo by all methods, one after the other; stops at the first that fails."""
    refuse_with_local(args, "socket")
    asked, files = parse_request_options(args), collect_array_files(args)
    without_mask = {
        name: path for name, path in files.items() if name not in ("prior", "codes_from")
    }
    rows: list[dict[str, Any]] = []
    results: list[CaptureResult] = []
    # Methods without a mask support fewer goals; first, so that they refuse before any exposure.
    for method in (*_COMPARED[1:], _COMPARED[0]):
        result = capture_photo(
            args, _by_method(asked, method), files if method == "coded" else without_mask
        )
        if result.state != "done":
            return say_result(result, as_json=args.json)
        rows.append(_compared_row(method, result))
        results.append(result)
    rows, results = [*rows[-1:], *rows[:-1]], [*results[-1:], *results[:-1]]
    if args.json:
        say_json({"goal": asked.goal, "methods": rows})
    else:
        _say(rows)
        for row, result in zip(rows, results, strict=True):
            quality = quality_of(result.summary)
            if quality is not None:
                say(f"{row['method']}: {quality.verdict}")
            say_notes(result)
    return DONE


def _by_method(request: CaptureRequest, method: MethodName) -> CaptureRequest:
    """The same request for another method, without options that need codes on both panels."""
    if method == "coded":
        return request
    # Without a mask there is no mask leak to subtract, and no coded photo to guide; "auto" looks at
    # ambient light all the same.
    return msgspec.structs.replace(request, method=method, pilot=0, prior=None, black_level="auto")


def _compared_row(method: MethodName, result: CaptureResult) -> dict[str, Any]:
    """One method in figures: with `quality`, the verdict on the photo."""
    summary = result.summary
    row = {name: read_summary_value(summary, key) for name, (key, _, _) in _FIGURES.items()}
    if summary.get("family") == "none":
        row["codes"] = None
    told = {"method": method, "job": result.job, "folder": result.folder}
    return {**told, **row, "quality": quality_of(summary)}


def _say(rows: Sequence[Mapping[str, Any]]) -> None:
    shown = {name: (head, unit) for name, (_, head, unit) in _FIGURES.items() if head}
    table = [["method", *(head for head, _ in shown.values())]]
    for row in rows:
        cells = (_figure(row[name], unit) for name, (_, unit) in shown.items())
        table.append([row["method"], *cells])
    say_table(table)


def _figure(value: float | str | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{float(value) * (100.0 if unit == ' %' else 1.0):.4g}{unit}"
