"""The darkroom of one run: reads each shot once, and makes pictures of the shots so far."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.bench.exposure_time import describe_time_conflict
from pdcd.bench.placed import place_panels
from pdcd.bench.stops import Stop, refuse_other_settings, stop_of
from pdcd.errors import DecodeError
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.patterns import Patterns, make_empty_patterns
from pdcd.pictures.bars import make_pictures_with_errors
from pdcd.pictures.border_lines import measure_border_blur
from pdcd.pictures.combine import find_telling_photo
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.exposed import AmbientLight, ExposedShot, RawShot, refuse_unlike
from pdcd.pictures.full import find_full_quads
from pdcd.pictures.leaks import DarkPhotoLight, ShotMeans
from pdcd.pictures.learn import PilotFindings, learn_paths
from pdcd.pictures.lost_samples import LostSamples
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.realise import compute_shot_matrix
from pdcd.pictures.repeated import RepeatedMatrices
from pdcd.pictures.software import sum_stack_matrices, sum_stack_shots
from pdcd.pictures.to_cells import average_shot, unmix_cells
from pdcd.pictures.upright import FieldView, place_quads
from pdcd.pictures.weights import RealisedMatrix, RealisedShot
from pdcd.probing.borders import BorderStrips, compute_cell_mismatch_share, find_strips
from pdcd.recipes.arrays import make_target
from pdcd.recipes.make import make_recipe, narrow_to_shots
from pdcd.recipes.parts import select_complete_parts
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.runs.frame_table import FrameTable
from pdcd.runs.patterns import read_patterns
from pdcd.runs.record import BorderPhoto, DarkPhoto, RunRecord, ShotRecord
from pdcd.sensor.bands import THREADS
from pdcd.sensor.cells import CellMap
from pdcd.sensor.colours import compute_colour_variance, to_colours
from pdcd.sensor.dead import can_tell_samples, find_dead_samples
from pdcd.sensor.raw import RawFrame, shrink_image
from pdcd.sensor.shelf import PhotoShelf
from pdcd.watch import Watch

if TYPE_CHECKING:
    from pdcd.pictures.border_light import BorderMeasurement

_Alive = Callable[[], None]

_REFRESH_BYTES = 2048
"""Bytes of a RAW file that are read in the time that the matrix of one refresh takes; roughly."""
_MOST_STRETCHES = 8
"""Most stretches of a cell's border for which it is worked out how far panels draw it apart."""
_MAKING = 2.0
"""Work of making pictures, over that of the matrices of all their refreshes; roughly."""


class Darkroom:
    """Makes pictures of what lies in a run folder; nothing is written.

    A RAW file and its refreshes are read once, when they are first needed. A `watch` gets the
    progress of the work, and may end it. All methods raise DecodeError for a lost or damaged file.
    """

    def __init__(self, folder: Path, record: RunRecord, shelf: PhotoShelf | None = None) -> None:
        """`shelf` has photos that are not in the folder."""
        self._folder = folder
        self._shelf = shelf or PhotoShelf(folder)
        self._side = 1
        self._table = FrameTable(folder)
        self._matrices: dict[str, RealisedMatrix] = {}
        self._exposed: dict[str, RawShot] = {}
        self._dark: dict[str, DarkPhotoLight] = {}
        self._learned: tuple[tuple[int, int, bool], PilotFindings] | None = None
        self._like: tuple[str, int] | None = None
        self._seen: tuple[object, tuple[BorderMeasurement | None, Floats | None]] | None = None
        self._lost = LostSamples()
        self.replan(record)

    @property
    def record(self) -> RunRecord:
        """The record of the run so far."""
        return self._record

    @property
    def recipe(self) -> Recipe:
        """What was planned."""
        return self._recipe

    def replan(self, record: RunRecord) -> None:
        """The run continues with another plan: its codes are read again, its shots are kept."""
        self._repeated = RepeatedMatrices(record.projector, record.mask)
        self._record = record
        self._stored = read_patterns(self._folder)
        arrays = {k[5:]: array for k, array in self._stored.items() if k.startswith("goal.")}
        self._recipe = make_recipe(make_target(record.goal, record.grid, arrays), record.how)
        self._planned = {shot.name: shot for shot in self._recipe.shots}
        telling = find_telling_photo(self._recipe)
        self._telling = {
            name
            for photo in self._recipe.photos
            if photo is telling or photo.wanted.uniform == (0.0, 1.0)
            for sign, name in photo.shots
            if sign > 0.0
        }

    def coarsen(self, side: int) -> None:
        """Make pictures of squares of `side` x `side` quads: less detail, in less time. To be
        called before anything is decoded, with a side that `CellMap.can_bin` allows."""
        self._side = side

    def set_stops(self, stops: tuple[Stop, ...]) -> None:
        """Set what is known of the light of lens stops, for the photos to come."""
        self._dark.clear()
        self._record = msgspec.structs.replace(self._record, stops=stops)

    def add(self, shot: ShotRecord) -> None:
        """One more shot was taken."""
        self._record = msgspec.structs.replace(self._record, shots=(*self._record.shots, shot))

    def renew(self, shot: ShotRecord, frames: Frames, log: FrameLog) -> None:
        """A shot was taken again, and replaces the one before, which is forgotten.

        frames, log : as frames.csv would give them back
        (`pdcd.runs.frame_table.restore_frames`). Raises DecodeError, also where the camera exposed
        for another time than was planned, and ExposureError for another ISO or stop; then nothing
        has changed.
        """
        raw, repeated = self._read(shot), self._repeated
        refuse_other_settings(shot.raw, (raw.iso, raw.f_number), shot.iso, shot.f_number)
        open_s = shot.open_s
        if doubt := describe_time_conflict(shot.planned_s or open_s, open_s, raw.exposure_s):
            raise DecodeError(doubt)
        realised = repeated.find(shot, frames, log) or compute_shot_matrix(
            self._record, shot, frames, log
        )
        repeated.keep(shot, frames, log, realised)
        exposed = self._develop(shot, raw, realised)
        shots = {one.name: one for one in self._record.shots} | {shot.name: shot}
        self._record = msgspec.structs.replace(self._record, shots=tuple(shots.values()))
        self._matrices[shot.name], self._exposed[shot.name] = realised, exposed

    def learned(self, watch: Watch | None = None) -> PilotFindings | None:
        """The findings of the pilot photos so far; None for a run without a pilot."""
        how = self._record.how
        if not how.pilot:
            return None
        shots = self._shots(watch or Watch())
        dark = self._record.dark
        key = sum(name in shots for name in self._recipe.stack), how.codes, dark is not None
        if self._learned is None or self._learned[0] != key:
            self._learned = key, self._learn(shots, dark)
        return self._learned[1]

    def _learn(self, shots: Mapping[str, ExposedShot], dark: DarkPhoto | None) -> PilotFindings:
        cells, bits = self.cells, self._bits("pilot")
        taken = [shots[name] for name in self._recipe.stack if name in shots]
        seen = unmix_cells(taken, cells)
        off = None if dark is None else unmix_cells([self.ambient(dark)], cells)
        panels = [shot.realised for shot in taken]
        return learn_paths(self._record.grid, panels, bits, self._record.how.codes, seen, off)

    def matrices(self) -> tuple[Recipe, dict[str, RealisedShot]]:
        """What the panels did in every shot and sum, without reading the RAW files."""
        shots: dict[str, RealisedShot] = {
            s.name: self._matrix(s, Watch()) for s in self._record.shots
        }
        recipe = select_complete_parts(self._recipe, shots)
        sums = sum_stack_matrices(recipe, shots, self._stack_bits()) if self._sums_up(shots) else {}
        return recipe, {**shots, **sums}

    def decoded(self, watch: Watch | None = None, *, partly: bool = False) -> DecodedRun:
        """The pictures that the shots taken so far make, all of the recipe's or of whole parts.

        partly : shots may be missing: the pictures that can be made without them, if any. Raises
        DecodeError where there are none.
        """
        watch = watch or Watch()
        making = _MAKING * sum(shot.refreshes for shot in self._record.shots)
        watch.expect(making)
        shots = self._shots(watch)
        cells = self.cells
        recipe = (narrow_to_shots if partly else select_complete_parts)(self._recipe, shots)
        if not recipe.pictures:
            raise DecodeError(
                "no picture can be made of the shots that are there", hint="capture again"
            )
        sums = self._sums(recipe, shots)
        with watch.piece(making) as alive:
            # Of an interrupted run the pilot may be incomplete; then there is no coded photo.
            learned = self.learned() if any(photo.paths for photo in recipe.photos) else None
            slow = {name: one.slow for name, one in self._matrices.items() if one.slow is not None}
            known = {**shots, **sums}, learned, cells, alive, *self.seen_light(), slow
            pictures = make_pictures_with_errors(self._record, recipe, *known)
            if self._sees_lines(recipe, pictures):  # error bars include their blur
                pictures = make_pictures_with_errors(self._record, recipe, *known)
        view = FieldView.of(self._record, cells)
        dead = self._lost.dead if self._side == 1 else None
        full = self.find_full_quads(recipe)
        crossed = {name: one.crossed for name, one in self._matrices.items() if one.crossed}
        apart = self._apart()
        return DecodedRun(
            recipe, shots, pictures, cells, view, sums, apart, self._side, dead, full, crossed
        )

    def _sees_lines(self, recipe: Recipe, pictures: Mapping[str, PictureWithErrors]) -> bool:
        """Whether lines along borders show a blur that was not known; it goes into the record."""
        look = self._record.panels
        if look is None or not look.upright:
            return False
        found = measure_border_blur(self._record, recipe, pictures, self.cells)
        if found == look.border_px:
            return False
        seen = msgspec.structs.replace(look, border_px=found)
        self._record = msgspec.structs.replace(self._record, panels=seen)
        return True

    def find_full_quads(self, recipe: Recipe) -> Bools | None:
        """Those of `pdcd.pictures.full`; None also where pictures are of squares of quads."""
        if self._side > 1:
            return None
        return find_full_quads(recipe, self._exposed, self.cells, self._lost.dead)

    def exposed(self, watch: Watch) -> tuple[Recipe, dict[str, ExposedShot]]:
        """Shots and sums so far, and the recipe of the photos that can be made of them."""
        shots = self._shots(watch)
        recipe = narrow_to_shots(self._recipe, shots)
        return recipe, {**shots, **self._sums(recipe, shots)}

    def renewed(self, name: str) -> ExposedShot:
        """The latest exposure of a shot."""
        return self._exposed[name]

    @property
    def cells(self) -> CellMap:
        """Where the quads lie; known from the first photo on. Raises DecodeError before it."""
        if self._record.cells is None:
            raise DecodeError("no photo was taken yet", hint="take at least one shot")
        cells = self._record.cells
        return cells if self._side == 1 else cells.binned(self._side)

    def means(self, watch: Watch) -> tuple[Recipe, ShotMeans]:
        """The same on cells, as far as the answer needs them."""
        recipe, shots = self.exposed(watch)
        return recipe, ShotMeans.of(recipe, shots, self.cells)

    def dark_means(self, photo: DarkPhoto) -> DarkPhotoLight:
        """Light in a dark photo within a second, on cells."""
        if photo.raw not in self._dark:
            self._dark[photo.raw] = DarkPhotoLight.of(average_shot(self.ambient(photo), self.cells))
        return self._dark[photo.raw]

    def widest_strip(self, watch: Watch) -> float:
        """Largest share of a quad in which both panels show different cells."""
        # most benches have no such borders
        from pdcd.pictures.border_light import compute_strip_shares

        self._shots(watch)
        return float(compute_strip_shares(self._strips, self.cells).max())

    def ambient(self, photo: DarkPhoto) -> AmbientLight:
        """Light in a dark photo, over the time for which it shows each of its states."""
        return self._ambient_of(self._dark_frame(photo), photo)

    def _dark_frame(self, photo: DarkPhoto) -> RawFrame:
        frame = self._shelf.read(
            photo.raw,
            sha256=photo.sha256,
            saturation_dn=self._record.profile.saturation_dn(photo.iso),
        )
        return frame if self._side == 1 else frame.binned(self._side)

    def _ambient_of(self, frame: RawFrame, photo: DarkPhoto) -> AmbientLight:
        profile, iso = self._record.profile, photo.iso
        factors, signal = self._to_units(iso, photo.f_number) / photo.phase_s, frame.planes
        of_quads = factors / frame.side
        variance = compute_colour_variance(
            signal, profile, iso, photo.exposure_s, of_quads, np.float64
        )
        return AmbientLight(to_colours(signal, factors), np.asarray(variance, np.float64))

    def seen_light(self) -> tuple[BorderMeasurement | None, Floats | None]:
        """Measured light along borders, and of the room, (N, C); each None where it was not
        photographed, the latter also where the room is dark."""
        record = self._record
        key = record.room, record.borders, record.stops
        if self._seen is None or self._seen[0] != key:
            borders = None if record.borders is None else self._seen_borders(record.borders)
            room = None if record.room is None else self.dark_means(record.room)
            lit = None if room is None or not room.seen else room.light
            self._seen = key, (borders, lit)
        return self._seen[1]

    def _seen_borders(self, photo: BorderPhoto) -> BorderMeasurement:
        """The measured light along borders; unknown at quads that are saturated there."""
        from pdcd.pictures.border_light import BorderMeasurement  # as above

        frame, inner = self._dark_frame(photo), self.ambient(photo.inner)
        lit = self._ambient_of(frame, photo)
        lit.variance[frame.saturated] = np.inf
        seen = AmbientLight(lit.light - inner.light, lit.variance + inner.variance)
        indirect = inner.light - self.ambient(photo.dark).light
        leak = 1.0 / (self._record.mask.contrast or math.inf)
        return BorderMeasurement(seen, indirect, photo.reach, leak)

    def _to_units(self, iso: int, f_number: float) -> NDArray[np.float64]:
        """From DN to scene units times seconds: electrons, then the camera's responsivity."""
        gain = self._record.profile.row(iso).gain_e_per_dn
        true = stop_of(f_number, self._record.stops).true
        contrast = self._record.projector.contrast or math.inf
        # Where black is subtracted with the room's light, a unit is white without that black.
        full = 1.0 if self._record.room is None else 1.0 - 1.0 / contrast
        return np.asarray(gain * true**2 / full / np.array(self._record.responsivity_e))

    def _apart(self) -> dict[str, float]:
        """The value of `DecodedRun.apart`."""
        whole = [shot.name for shot in self._record.shots if shot.window == "whole"]
        return dict.fromkeys(whole, self._drawn_apart) if whole else {}

    @cached_property
    def _drawn_apart(self) -> float:
        """Share of the field in which the panels draw different cells; the same for all shots."""
        panels = place_panels(self._record.projector, self._record.mask)
        return compute_cell_mismatch_share(panels.projector, panels.mask, self._record.grid)

    @cached_property
    def _strips(self) -> tuple[BorderStrips, ...]:
        """Where whole cells of both panels do not meet, as finely as the camera sees them."""
        panels = place_panels(self._record.projector, self._record.mask)
        fine = min(max(1, math.ceil(self.cells.quad_cells**-0.5 - 1e-6)), _MOST_STRETCHES)
        return find_strips(panels.projector, panels.mask, self._record.grid, fine)

    def _sums_up(self, shots: Mapping[str, RealisedShot]) -> bool:
        """Whether all photos that the recipe's sums need are there."""
        return bool(self._recipe.sums) and all(name in shots for name in self._recipe.stack)

    def _sums(self, recipe: Recipe, shots: Mapping[str, ExposedShot]) -> dict[str, ExposedShot]:
        """Weighted sums of single photos, for `DecodedRun.sums`."""
        if not self._sums_up(shots):
            return {}
        return sum_stack_shots(recipe, shots, self._stack_bits(), self.cells)

    def _stack_bits(self) -> NDArray[np.bool_]:
        return self._bits("pilot" if self._record.how.pilot else "photos")

    def _bits(self, program: str) -> NDArray[np.bool_]:
        """What the projector showed in the single-code photos, (K, N)."""
        primal, _ = self._patterns(program)
        cells = self._recipe.target.cells
        return np.unpackbits(np.asarray(primal, np.uint8), axis=1, count=cells).astype(np.bool_)

    def _patterns(self, program: str) -> tuple[Patterns, Patterns]:
        try:
            return self._stored[f"{program}.primal"], self._stored[f"{program}.dual"]
        except KeyError as err:
            raise DecodeError(
                f"codes.npz lacks the patterns of {program}", hint="restore it from a copy"
            ) from err

    def _pair(self, shot: Shot) -> tuple[Patterns, Patterns]:
        """Patterns of a shot; none for a white one."""
        if shot.white:
            return make_empty_patterns(), make_empty_patterns()
        primal, dual = self._patterns(shot.program)
        if shot.only is None:
            return primal, dual
        return primal[shot.only : shot.only + 1], dual[shot.only : shot.only + 1]

    def _matrix(self, shot: ShotRecord, alive: _Alive) -> RealisedMatrix:
        if shot.name not in self._matrices:
            pair = self._pair(self._planned[shot.name])
            frames, log = self._table.of(shot, pair, grid=self._record.grid)
            alive()
            crossed = shot.name in self._telling
            self._matrices[shot.name] = compute_shot_matrix(
                self._record, shot, frames, log, alive, crossed=crossed
            )
        return self._matrices[shot.name]

    def _shots(self, watch: Watch) -> dict[str, ExposedShot]:
        unread = [shot for shot in self._record.shots if shot.name not in self._exposed]
        if self._side > 1:  # dead quads have to be known before squares of them are made
            unread.sort(key=lambda shot: not self._planned[shot.name].all_light)
        watch.expect(sum(map(_reading, unread)))
        # Files are unpacked by one core each, while another works on what the panels did.
        with ThreadPoolExecutor(THREADS) as pool:
            files = [pool.submit(self._read, shot) for shot in unread]
            try:
                for shot, file in zip(unread, files, strict=True):
                    with watch.piece(_reading(shot)) as alive:
                        shown = self._matrix(shot, alive)
                        self._exposed[shot.name] = self._develop(shot, file.result(), shown)
            finally:
                pool.shutdown(cancel_futures=True)
        return dict(self._exposed)

    def _read(self, shot: ShotRecord) -> RawFrame:
        return self._shelf.read(
            shot.raw,
            sha256=shot.sha256,
            size_bytes=shot.size_bytes,
            saturation_dn=self._record.profile.saturation_dn(shot.iso),
        )

    def _develop(self, shot: ShotRecord, raw: RawFrame, shown: RealisedMatrix) -> RawShot:
        """A shot made of its RAW file, and what the panels did in it."""
        profile = self._record.profile
        self._check(shot, raw)
        raw = self._without_dead(shot, self._lost.mark_full(raw, profile, shot.iso))
        raw = raw if self._side == 1 else raw.binned(self._side, self._lost.dead)
        factors = self._to_units(shot.iso, shot.f_number) / (shot.level or 1.0)
        realised = shown.realised
        if shot.window == "whole":
            realised = replace(realised, apart=self._strips)
        return RawShot(raw, profile, shot.iso, shot.open_s, factors, realised, shown.missed)

    def _without_dead(self, shot: ShotRecord, raw: RawFrame) -> RawFrame:
        """The same with dead quads marked as saturated, hence unknown. If this white shot is the
        first to show them, they are marked in the earlier shots, too."""
        cells = self._record.cells if self._planned[shot.name].all_light else None
        if self._lost.dead is None and cells is not None and can_tell_samples(cells):
            self._lost.dead = find_dead_samples(raw, self._record.profile, shot.iso)
            dead = self._lost.dead
            if self._side > 1:
                dead = shrink_image(dead.astype(np.float32), self._side) > 0.0
            for name, one in self._exposed.items():
                self._exposed[name] = replace(one, raw=one.raw.without(dead))
        return raw if self._lost.dead is None else raw.without(self._lost.dead)

    def _check(self, shot: ShotRecord, raw: RawFrame) -> None:
        """Note the format of the first photo, and refuse others that differ. Raises DecodeError."""
        cells = self._record.cells or place_quads(self._record, raw.frame)
        if self._record.cells is None:
            self._record = msgspec.structs.replace(self._record, cells=cells)
        self._like = self._like or (raw.model, raw.flip)
        colours = len(self._record.responsivity_e)
        refuse_unlike(shot.raw, raw, cells.frame, colours, self._like)


def _reading(shot: ShotRecord) -> float:
    """Work of reading a shot, in refreshes."""
    return shot.refreshes + shot.size_bytes / _REFRESH_BYTES
