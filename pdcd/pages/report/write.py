"""`report.html` of a run: one file that opens from the disk, without a network."""

from __future__ import annotations

from pathlib import Path

from pdcd.files.put import put_file
from pdcd.pages.report.layers import enough_side
from pdcd.pages.report.material import Material, gathered
from pdcd.pages.report.page import page
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import TRANSPORT_PICTURE, record_errors
from pdcd.pictures.truth import TRUTH, read_truth
from pdcd.runs.frame_table import NAME as FRAMES
from pdcd.runs.later import REPORT
from pdcd.runs.patterns import NAME as CODES
from pdcd.runs.record import Manifest
from pdcd.runs.verify import sound_manifest
from pdcd.watch import Watch


def write(folder: Path, out: Path | None = None, watch: Watch | None = None) -> Path:
    """Write the page of a finished run, or of one that was cut, and return where it is.

    out : the file; None is `report.html` in the run's folder. `watch` is told how far it is.

    The run is decoded anew, as only that tells the error of every pixel, but no finer than a page
    shows it. Raises DecodeError when the manifest, codes, frame log or RAW files have changed,
    NoSpaceError, or DiskError for any other refusal of the disk.
    """
    watch = watch or Watch()
    manifest = sound_manifest(folder, (CODES, FRAMES), watch)
    partly, kept = manifest.state == "partial", TRUTH in manifest.files
    more = [TRUTH] if kept else []
    if manifest.run.goal.name == "transport":
        more.append(TRANSPORT_PICTURE)
    sound_manifest(folder, more, watch)
    with record_errors(folder):
        darkroom = Darkroom(folder, manifest.run)
        darkroom.coarsen(enough_side(len(darkroom.recipe.pictures), manifest.run))
        decoded = darkroom.decoded(watch, partly=partly)
        cells = darkroom.record.cells
        known = read_truth(folder, cells) if kept and cells is not None else None
        material = gathered(folder, darkroom.record, decoded, known)
    return written(folder, manifest, material, out)


def written(folder: Path, manifest: Manifest, material: Material, out: Path | None = None) -> Path:
    """Write a page whose parts are gathered; returns where it is. Raises as `write` does."""
    path = folder / REPORT if out is None else out
    put_file(path, page(manifest, material).encode("utf-8"))
    return path
