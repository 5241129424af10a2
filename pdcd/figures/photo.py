"""One capture on the bench of the figures, of which pictures and their truth are kept.

The run folder, RAW files and all, is removed once its pictures are on the field's raster: a page of
figures takes some hundred photos of up to 25 MB each.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.api.arguments import make_request
from pdcd.api.bench import open_finished_run
from pdcd.api.local import LocalBench, local
from pdcd.api.run import Run
from pdcd.capture.worker.truths import compute_true_pictures
from pdcd.errors import Cancelled, PdcdError
from pdcd.figures.bench import BORDER_PX, PROJECTOR_PX, count_equal_photos, make_figure_config
from pdcd.figures.figure import FigureMode, FigurePhoto, FigureTake
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import TRANSPORT
from pdcd.pictures.truth import TRUTH, compute_true_entries, read_known_answer
from pdcd.pictures.upright import FieldSampler, FieldView
from pdcd.runs.patterns import read_stored_arrays
from pdcd.sensor.cells import CellMap
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.scene.scene import Scene

_Heard = Callable[[], None]
_ASPECT = 0.75
"""Height of the field over its width."""


def photograph_takes(
    takes: Mapping[str, FigureTake], mode: FigureMode, heard: _Heard = lambda: None
) -> Iterator[tuple[str, FigurePhoto]]:
    """Take captures, and yield them with their names; those that share a bench
    (`FigureTake.stands`) follow each other.

    Runs go to a scratch folder, which is removed afterwards. `heard` is called now and then; it may
    raise to end the work. Raises PdcdError, whose message names the capture that failed.
    """
    benches: dict[str, dict[str, FigureTake]] = {}
    for name, take in takes.items():
        benches.setdefault(take.stands, {})[name] = take
    for some in benches.values():
        with tempfile.TemporaryDirectory(prefix="pdcd-figures-") as scratch:
            folder = Path(scratch)
            config = make_figure_config(next(iter(some.values())), mode, folder)
            with local(config, folder=folder) as bench:
                for name, take in some.items():
                    try:
                        yield name, _photograph(bench, take, mode, heard)
                    except Cancelled:
                        raise
                    except PdcdError as err:
                        said = f"{take.goal} before {take.scene}: {err.message}"
                        raise PdcdError(said, device=err.device, hint=err.hint) from err


def _photograph(
    bench: LocalBench, take: FigureTake, mode: FigureMode, heard: _Heard
) -> FigurePhoto:
    """Take one photo, as `Bench.capture` does, but without a report; the run is gone after it."""
    keywords = dict(take.asked)
    photos = count_equal_photos(mode.profile)
    if photos > 1 and take.f_number is None:  # with f_number, the light of one photo matters
        keywords["repeat"] = photos
    if "codes" in keywords:  # the paper's photos are one exposure each
        keywords = {"pilot": 0, "parts": 1, **keywords}
        if not take.all_codes:
            keywords["codes"] = mode.codes(keywords["codes"])
    if bench.optics is None:
        raise PdcdError("the bench of the figures is not one of pixels")
    request, arrays = make_request(take.goal, keywords, lambda: bench.grid)
    run = open_finished_run(bench.take(request, arrays, on_event=lambda event: heard()))
    photo = _beside_truth(run, bench.optics, mode, heard)
    shutil.rmtree(run.folder)
    return photo


def _beside_truth(run: Run, optics: OpticalBench, mode: FigureMode, heard: _Heard) -> FigurePhoto:
    """A run together with its truth, computed by the bench that it was taken with."""
    record = run.manifest.run
    recipe, cells = Darkroom(run.folder, record).recipe, record.cells
    colours = len(record.responsivity_e)
    if cells is None:
        raise PdcdError(f"{run.folder} does not say where its cells are")
    sampler = FieldSampler(
        FieldView.of(record, cells), (mode.width_px, round(mode.width_px * _ASPECT))
    )
    pictures, truths, errors = {}, {}, {}
    kept = {}
    if TRUTH in run.manifest.files:
        kept[recipe.answer_name] = read_known_answer(run.checked(TRUTH).parent, cells).image
    for name, truth in compute_true_pictures(recipe, optics, heard, kept, colours=colours).items():
        image = run.pictures[name]
        known = np.isfinite(image).all(axis=-1) & cells.known
        pictures[name] = _on_field(sampler, image, known)
        truths[name] = _on_field(sampler, truth, np.ones_like(known))
        errors[name] = _error(image, truth, optics.inside & known & _off_border(cells))
    transport, transport_truth = _transport(run, optics.scene)
    summary = msgspec.to_builtins(dict(run.summary))
    return FigurePhoto(pictures, truths, errors, transport, transport_truth, summary, run.grid)


def _transport(run: Run, scene: Scene) -> tuple[NDArray[Any] | None, NDArray[Any] | None]:
    if TRANSPORT not in run.manifest.files:
        return None, None
    data = read_stored_arrays(run.checked(TRANSPORT))
    found = np.where(np.isfinite(data["sigma"]), data["transport"], np.nan)
    seen, lit = data["camera_cells"], data["projector_cells"]
    return found, compute_true_entries(scene, seen, lit, colours=found.shape[2])


def _on_field(sampler: FieldSampler, image: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[Any]:
    seen, where = sampler(image, known)
    seen[~where] = np.nan
    return seen


def _off_border(cells: CellMap) -> NDArray[np.bool_]:
    """(h, w), quads whose centres lie at least `BORDER_PX` inside the field."""
    border = BORDER_PX / np.array(PROJECTOR_PX)
    return np.asarray(((cells.centres >= border) & (cells.centres <= 1.0 - border)).all(axis=-1))


def _error(image: NDArray[Any], truth: NDArray[Any], where: NDArray[np.bool_]) -> float:
    total = float(np.sum(truth[where] ** 2))
    off = float(np.sum((image[where] - truth[where]) ** 2))
    return float(np.sqrt(off / total)) if total else float("nan")
