"""Writes `report.html` of a run: one file that opens from the disk, without a network, with words,
tables, and the data of its script."""

from __future__ import annotations

import base64
import re
from pathlib import Path
from typing import Any

from pdcd.files.put import replace_file
from pdcd.pages.render import encode_page_json, load_template, render_page
from pdcd.pages.report.facts import MOST_ROWS, list_key_figures, list_tables
from pdcd.pages.report.layers import choose_bin_side
from pdcd.pages.report.material import Material, gather_material
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import TRANSPORT_PICTURE, convert_record_errors
from pdcd.pictures.truth import TRUTH, read_known_answer
from pdcd.printable import to_one_line
from pdcd.runs.folder import REPORT_FILE
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.patterns import CODES_FILE as CODES
from pdcd.runs.record import Manifest
from pdcd.runs.verify import read_sound_manifest
from pdcd.watch import Watch

TEMPLATE = "report.html"
_SCRIPTS = ("unpack.js", "draw.js", "pictures.js", "matrix.js", "timeline.js", "start.js")
"""Parts of the one script, in order."""


def write_report(folder: Path, out: Path | None = None, watch: Watch | None = None) -> Path:
    """Write the page of a finished or interrupted run, and return where it is.

    out : the file; None is `report.html` in the run's folder. `watch` hears of the progress.

    The run is decoded anew, as only decoding gives the error of every pixel, but no finer than a
    page shows it. Raises DecodeError when the manifest, codes, frame log or RAW files have changed,
    NoSpaceError, or DiskError for any other refusal of the disk.
    """
    watch = watch or Watch()
    load_template(TEMPLATE)
    manifest = read_sound_manifest(folder, (CODES, FRAMES), watch)
    manifest.require_photos()
    partly, kept = manifest.state == "partial", TRUTH in manifest.files
    more = [TRUTH] if kept else []
    if manifest.run.goal.name == "transport":
        more.append(TRANSPORT_PICTURE)
    read_sound_manifest(folder, more, watch)
    with convert_record_errors(folder):
        darkroom = Darkroom(folder, manifest.run)
        darkroom.coarsen(choose_bin_side(len(darkroom.recipe.pictures), manifest.run))
        decoded = darkroom.decoded(watch, partly=partly)
        cells = darkroom.record.cells
        known = read_known_answer(folder, cells) if kept and cells is not None else None
        material = gather_material(folder, darkroom.record, decoded, known)
    return write_gathered_report(folder, manifest, material, out)


def write_gathered_report(
    folder: Path, manifest: Manifest, material: Material, out: Path | None = None
) -> Path:
    """Write a page whose parts are gathered; returns where it is. Raises as `write_report` does."""
    path = folder / REPORT_FILE if out is None else out
    replace_file(path, render_report_page(manifest, material).encode("utf-8"))
    return path


def render_report_page(manifest: Manifest, material: Material) -> str:
    """The whole page."""
    return render_page(
        TEMPLATE,
        _SCRIPTS,
        manifest=manifest,
        layers=material.layers,
        kind=material.kind,
        when=_when(manifest.started_utc),
        said={n: _lines(manifest.request[n]) for n in _SAID if manifest.request.get(n)},
        sides=_sides(manifest),
        figures=list_key_figures(manifest, material),
        tables=list(list_tables(manifest, material)),
        most_rows=MOST_ROWS,
        slice=base64.b64encode(material.slice_png).decode("ascii"),
        data=encode_page_json(_told(manifest, material)),
    )


def _told(manifest: Manifest, material: Material) -> dict[str, Any]:
    """The data for the page's script."""
    pictures = material.layers
    return {
        "job": to_one_line(manifest.job),
        "goal": manifest.run.goal.name,
        "size": pictures.size_px,
        "quads": pictures.quads,
        "scale": pictures.scale,
        "balance": pictures.balance,
        "pictures": pictures.data,
        "answer": material.answer,
        "photos": material.matrices,
        "shots": material.shots,
        "grid": manifest.run.grid,
    }


_SAID = ("name", "tags", "note")
"""Fields of a request that are shown as the user wrote them."""


def _lines(value: object) -> list[str]:
    words = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
    return words.split("\n")


def _sides(manifest: Manifest) -> list[tuple[str, str]]:
    """Reasons for and against a photo: kind and words of each."""
    found, told = manifest.quality, manifest.summary
    cut = [f"missing shots: {', '.join(manifest.missing)}"] if manifest.state == "partial" else []
    return [
        *(("partial", words) for words in cut),
        *(("reason", words) for words in found.reasons),
        *((name, str(told[name])) for name in ("decided", "taken") if told.get(name)),
        *(("remark", words) for words in found.remarks),
        *(("warning", words) for words in manifest.warnings[:MOST_ROWS]),
    ]


def _when(utc: str) -> str:
    """2026-01-01T12:03:01.2Z -> 2026-01-01 12:03:01 UTC."""
    found = re.match(r"(\d{4}-\d\d-\d\d)T(\d\d:\d\d:\d\d)", utc)
    return f"{found[1]} {found[2]} UTC" if found else utc
