"""`pdcd compare`: one goal by every method on the same rig and scene, side by side."""

from __future__ import annotations

import argparse

import msgspec

from pdcd.cli.capture import refuse_with_local, take
from pdcd.cli.exits import DONE
from pdcd.cli.output import say, say_json, say_notes, say_result, say_table
from pdcd.cli.request import arrays_of, request_of
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality, figure_of, quality_of
from pdcd.words import MethodName

COMPARED: tuple[MethodName, ...] = ("coded", "multi-image", "nayar")
"""Ways of photographing that differ in more than how light is gathered."""


class Compared(msgspec.Struct, frozen=True, kw_only=True):
    """One method in figures.

    `codes` is None where a method has none of its own choosing. `raw_files` is without test
    exposures; `rms_error_quads` and `rms_error_cells` are relative to the scene's known truth, None
    where there is none.
    `sigma_mean` is in scene units.
    """

    method: MethodName
    job: str
    folder: str | None
    codes: float | int | str | None
    raw_files: float | int | str | None
    exposure_s: float | int | str | None
    rms_error_quads: float | int | str | None
    rms_error_cells: float | int | str | None
    sigma_mean: float | int | str | None
    wall_s: float | int | str | None
    quality: Quality | None
    """The verdict on the photo."""


def compare(args: argparse.Namespace) -> int:
    """Take the photo by all methods, one after the other; ends at the first that fails."""
    refuse_with_local(args, "socket")
    asked, files = request_of(args), arrays_of(args)
    without_prior = {name: path for name, path in files.items() if name != "prior"}
    rows, results = [], []
    for method in COMPARED:
        result = take(args, by_method(asked, method), files if method == "coded" else without_prior)
        if result.state != "done":
            return say_result(result, as_json=args.json)
        rows.append(_compared(method, result))
        results.append(result)
    if args.json:
        say_json({"goal": asked.goal, "methods": rows})
    else:
        _say(rows)
        for row, result in zip(rows, results, strict=True):
            if row.quality is not None:
                say(f"{row.method}: {row.quality.verdict}")
            say_notes(result)
    return DONE


def by_method(request: CaptureRequest, method: MethodName) -> CaptureRequest:
    """The same request by another method, without what only codes on both panels can use."""
    if method == "coded":
        return request
    # Without a mask there is no mask leak to subtract, and no coded photo to guide.
    return msgspec.structs.replace(request, method=method, pilot=0, prior=None, black_level="none")


def _compared(method: MethodName, result: CaptureResult) -> Compared:
    summary = result.summary
    return Compared(
        method=method,
        job=result.job,
        folder=result.folder,
        codes=figure_of(summary, "codes") if summary.get("family") != "none" else None,
        raw_files=figure_of(summary, "shots"),
        exposure_s=figure_of(summary, "exposure_s"),
        rms_error_quads=figure_of(summary, "rms_error_quads"),
        rms_error_cells=figure_of(summary, "rms_error_cells"),
        sigma_mean=figure_of(summary, "sigma_mean"),
        wall_s=figure_of(summary, "wall_s"),
        quality=quality_of(summary),
    )


def _say(rows: list[Compared]) -> None:
    table = [["method", "codes", "RAW files", "exposure", "RMS error", "mean sigma", "wall time"]]
    for row in rows:
        error = None if row.rms_error_quads is None else 100.0 * float(row.rms_error_quads)
        table.append(
            [
                row.method,
                _figure(row.codes, ""),
                _figure(row.raw_files, ""),
                _figure(row.exposure_s, " s"),
                _figure(error, " %"),
                _figure(row.sigma_mean, ""),
                _figure(row.wall_s, " s"),
            ]
        )
    say_table(table)


def _figure(value: float | int | str | None, unit: str) -> str:
    return "-" if value is None else f"{float(value):.4g}{unit}"
