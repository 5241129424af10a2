"""A run on disk as an object: files are read when asked for, and only if unchanged."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pdcd.api.progress import ProgressChoice, show_progress
from pdcd.arrays import Floats
from pdcd.errors import ConfigError, DecodeError, RequestError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import MAX_PICTURE_BYTES, hash_file, read_file, refuse_unsound
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import Patterns, has_cell_count, read_pattern_levels
from pdcd.protocol.result import Quality, SummaryValue
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.frame_table import read_frame_columns
from pdcd.runs.manifest import MANIFEST, MAX_MANIFEST_BYTES
from pdcd.runs.patterns import CODES_FILE as CODES
from pdcd.runs.patterns import read_patterns, read_stored_arrays
from pdcd.runs.record import Manifest
from pdcd.runs.verify import PROBE, read_sound_manifest
from pdcd.words import NormaliseName, VerdictName

if TYPE_CHECKING:
    from pdcd.api.decoding import DecodingResult
    from pdcd.pictures.row import MatrixRow
    from pdcd.verdict.error_budget import ErrorRow


_PANELS = ("primal", "dual")
_MOST_PREVIEWS = 4
"""Most previews of a run that a notebook shows."""


def open_run(folder: Path | str) -> Run:
    """Open the folder of a run; `pdcd.open` is its public name.

    Only the manifest is read, and checked against its digest; each file is checked against the
    manifest when it is first used. Raises DecodeError if it is not a finished run, or was changed,
    and RequestError if `folder` is not a path.
    """
    if not isinstance(folder, str | os.PathLike):
        raise RequestError(
            f"a folder of type {type(folder).__name__} was given", hint="give the path of a run"
        )
    return Run(Path(folder))


@dataclass(frozen=True, eq=False)
class _Codes:
    """What both panels showed in one program, a pattern for each code: (K, rows, cols) bool, or
    float64 levels relative to the highest, 0..1, where the panels show greys.

    rows, cols : of the lattice, one more than those of cells where the mask opens parts of cells.
    """

    projector: NDArray[Any]
    mask: NDArray[Any]


class Run:
    """One run. Its attributes are read when they are first asked for; only `report` writes.

    All raise DecodeError for a file that is lost or changed.
    """

    def __init__(self, folder: Path) -> None:
        self.manifest: Manifest = read_sound_manifest(folder, ())
        """Everything in capture.json (docs/run-folder.md)."""
        self.folder = folder.absolute()
        """The folder of the run."""

    @cached_property
    def manifest_sha256(self) -> str:
        """SHA-256 of capture.json: kept elsewhere, it proves that the run was not forged."""
        with refuse_unsound(self.folder / MANIFEST):
            return hash_file(self.folder / MANIFEST, MAX_MANIFEST_BYTES)

    @property
    def job(self) -> str:
        """Name of the run."""
        return self.manifest.job

    @property
    def goal(self) -> str:
        """The goal that was asked for."""
        return self.manifest.run.goal.name

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.manifest.run.grid

    @property
    def summary(self) -> Mapping[str, SummaryValue]:
        """Figures of the run: "codes", "exposure_s", "rms_sigma", "rms_error_quads" ..., None where
        a figure is not known."""
        return self.manifest.summary

    @property
    def quality(self) -> Quality:
        """The verdict with its reasons."""
        return self.manifest.quality

    @property
    def verdict(self) -> VerdictName:
        """ "good", "doubtful" or "bad"."""
        return self.quality.verdict

    @property
    def rms_sigma(self) -> float | None:
        """RMS of the standard deviation over that of the picture; None if it is not known."""
        return self._number("rms_sigma")

    @property
    def scale_sigma(self) -> float | None:
        """Standard deviation of the scale that all pixels share, relative; None if unknown.
        `summary["scale"]` says what the scale is based on; `sigma` does not include it."""
        return self._number("scale_sigma")

    @property
    def rms_error_quads(self) -> float | None:
        """RMS error of the picture's quads, with their noise and the detail within cells, over the
        RMS of the truth; None if the scene is not known."""
        return self._number("rms_error_quads")

    @property
    def rms_error_cells(self) -> float | None:
        """The same of `image`, means over the cells."""
        return self._number("rms_error_cells")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the run, a line each."""
        return self.manifest.warnings

    @cached_property
    def image(self) -> Floats:
        """The picture that was asked for, means over the cells, (rows, cols, 3) float64, or
        (rows, cols, 1) of a camera without colours, linear, in scene units, signed. 0 where the
        camera does not see a cell."""
        return np.asarray(self._probe["image"])

    @cached_property
    def sigma(self) -> Floats:
        """Standard deviation of `image`, the same shape; infinite where nothing is known."""
        return np.asarray(self._probe["sigma"])

    @cached_property
    def truth(self) -> Floats | None:
        """The true values of `image`, the same shape; None where the scene is not known, NaN where
        a cell cannot be compared."""
        from pdcd.pictures.truth import TRUTH, read_known_answer

        cells = self.manifest.run.cells
        if TRUTH not in self.manifest.files or cells is None:
            return None
        return read_known_answer(self.checked(TRUTH).parent, cells).on_cells(cells)

    @property
    def sigma_kind(self) -> str:
        """How `sigma` accounts for the error of the codes: "measured", by the spread of parts;
        "sensor": it is not known, and `sigma` is without it; "whole": there is none."""
        return str(self.summary.get("sigma_kind", "sensor"))

    @cached_property
    def pictures(self) -> Mapping[str, NDArray[np.float32]]:
        """All pictures by name, such as "direct", each (h, w, 3) float32, or (h, w, 1), in the
        camera's own geometry, a pixel for each quad of the sensor; linear, in scene units."""
        return _Pictures(self)

    @cached_property
    def codes(self) -> Mapping[str, _Codes]:
        """The codes that the panels were sent, by program; empty where a run shows no codes."""
        if CODES not in self.manifest.files:
            return {}
        self.checked(CODES)
        stored = read_patterns(self.folder)
        names = [name.removesuffix(".primal") for name in stored if name.endswith(".primal")]
        try:
            return {
                name: _Codes(*(self._patterns(name, stored[f"{name}.{p}"]) for p in _PANELS))
                for name in names
            }
        except (KeyError, ValueError) as err:
            raise DecodeError(f"{CODES} is damaged: {err}", hint="restore it from a copy") from err

    @cached_property
    def frames(self) -> dict[str, NDArray[Any]]:
        """frames.csv by column: "shot" str, all others int64, an entry for each refresh."""
        return read_frame_columns(self.checked(FRAMES))

    def raw(self, shot: str) -> NDArray[np.float32]:
        """The RAW file of a shot in DN above black, (4, h, w) float32: red, the green beside it,
        the green beside blue, and blue of each quad; (1, h, w) for a camera without colours.

        shot : name of its file in `raw/`, without ending: "coded-1", "white", "look-dark" ...
        Raises ConfigError where there is no such file, DecodeError where it was not kept.
        """
        from pdcd.sensor.raw import read_raw

        names = {Path(name).stem: name for name in self.manifest.files if name.startswith("raw/")}
        if shot not in names:
            if any(Path(name).stem == shot for name in self.manifest.unkept):
                self.manifest.require_photos()
            raise ConfigError(f"there is no photo {shot!r}", hint=f"there are {', '.join(names)}")
        record = self.manifest.files[names[shot]]
        return read_raw(
            self.checked(names[shot]), sha256=record.sha256, size_bytes=record.size_bytes
        ).planes

    def row(self, row: int, column: int, photo: str | None = None) -> MatrixRow:
        """Weights of the paths from every projector cell to one camera cell, as wanted and as
        realised: `.wanted` and `.realised`, (rows, cols) float64.

        photo : which photo; None takes the one that the answer rests on. Raises ConfigError where
        there is no such cell or photo.
        """
        from pdcd.pictures.row import read_matrix_row

        return read_matrix_row(self.folder, (row, column), photo)

    def decode(
        self,
        *,
        smooth: bool | None = None,
        normalise: NormaliseName | None = None,
        parts: int | None = None,
        progress: ProgressChoice = True,
    ) -> DecodingResult:
        """Make the pictures again from the RAW files, with other options; nothing is written.

        Parameters
        ----------
        smooth, normalise : as for a capture; None: as in the run.
        parts : use only this many of its parts, the first ones.
        progress : as for a capture.

        Raises RequestError for a number of parts that the run does not have.
        """
        from pdcd.api.decoding import decode_again

        self._check_sources()
        with show_progress(progress) as on_event:
            return decode_again(
                self.folder,
                self.manifest.run,
                smooth=smooth,
                normalise=normalise,
                parts=parts,
                on_event=on_event,
            )

    def error_budget(self, progress: ProgressChoice = True) -> tuple[ErrorRow, ...]:
        """What scale, stops, maps, timing, codes and noise contribute to the error of the picture
        that was asked for; the last row is the whole error. Each row has `.name`, `.share` of the
        picture's RMS, `.rms` in scene units, and `.source`; share and rms are None where they are
        not known. The run is decoded anew for it, and nothing is written.

        progress : as for a capture.
        """
        from pdcd.api.decoding import compute_error_budget

        self._check_sources()
        with show_progress(progress) as on_event:
            return compute_error_budget(self.folder, self.manifest.run, on_event)

    def report(self, out: Path | str | None = None) -> Path:
        """Write the page of the run, one file for a browser, and return where it is.

        out : the file; None: `report.html` in the run's folder. Raises NoSpaceError and DiskError.
        """
        from pdcd.pages.report.write import write_report

        return write_report(self.folder, None if out is None else Path(out))

    def checked(self, name: str) -> Path:
        """Path of one file of the run, checked against the manifest. Raises DecodeError."""
        read_sound_manifest(self.folder, (name,))
        return self.folder / name

    def _check_sources(self) -> None:
        """Raise DecodeError unless all that pictures are made of is there and unchanged."""
        self.manifest.require_photos()
        for name in (CODES, FRAMES):
            if name in self.manifest.files:
                self.checked(name)

    def __repr__(self) -> str:
        told = [f"{self.summary['codes']} codes"] if self.summary.get("codes") else []
        return f"<Run {self.job}: {self.goal}, {', '.join([*told, self.verdict])}>"

    def _repr_html_(self) -> str:
        from pdcd.api.html import format_run_html

        told = self.job, self.goal, self.folder, self.summary, self.quality, self.warnings
        return format_run_html(*told, self._previews())

    def _previews(self) -> Iterator[tuple[str, bytes]]:
        """The first previews by name, as PNG: that of the answer, then the others."""
        answer = str(self.summary.get("picture"))
        files = (n for n in self.manifest.files if n.startswith("preview/") and n.endswith(".png"))
        names = [n for n in (f[8:-4] for f in files) if n == "transport" or n in self.pictures]
        names.sort(key=lambda name: (name != answer, name))
        for name in names[:_MOST_PREVIEWS]:
            # Previews are only to look at: reading the numbers raises an error instead.
            with suppress(DecodeError, UnsoundFileError, OSError):
                yield name, read_file(self.checked(f"preview/{name}.png"), MAX_PICTURE_BYTES)

    @cached_property
    def _probe(self) -> dict[str, NDArray[Any]]:
        found = read_stored_arrays(self.checked(PROBE))
        shape = *self.grid, self._colours
        if any(found[n].shape != shape for n in ("image", "sigma") if n in found):
            raise DecodeError(f"{PROBE} is not over the run's cells", hint="see pdcd verify")
        return found

    @property
    def _colours(self) -> int:
        return len(self.manifest.run.responsivity_e)

    def _number(self, name: str) -> float | None:
        found = self.summary.get(name)
        return float(found) if isinstance(found, float | int) else None

    def _patterns(self, program: str, stored: Patterns) -> NDArray[Any]:
        """Stored patterns of one panel as pictures of it. Raises ValueError."""
        shots = self.manifest.run.shots
        # Names of shots begin with their program's; a program that was never shown has no shots.
        mine = [s for s in shots if s.name.startswith(program)] or shots
        for window in dict.fromkeys(shot.window for shot in mine):
            rows, cols = Lattice(self.grid, window).shape
            if has_cell_count(stored, rows * cols) and len(stored):
                levels = [read_pattern_levels(stored, k, rows * cols) for k in range(len(stored))]
                whole = np.stack(levels).reshape(-1, rows, cols)
                return whole.astype(np.bool_) if stored.dtype == np.uint8 else whole
        return np.zeros((0, *self.grid), dtype=np.bool_)


class _Pictures(Mapping[str, NDArray[np.float32]]):
    """The linear pictures of a run, each read when it is asked for."""

    def __init__(self, run: Run) -> None:
        self._run = run
        files = run.manifest.files
        self._names = [n[7:-4] for n in files if n.startswith("linear/") and n.endswith(".tif")]
        self._read: dict[str, NDArray[np.float32]] = {}

    def __getitem__(self, name: str) -> NDArray[np.float32]:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._read:
            from pdcd.pictures.written.picture_files import read_tiff

            self._read[name] = read_tiff(self._run.checked(f"linear/{name}.tif"))
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"<pictures {', '.join(self._names)}>"
