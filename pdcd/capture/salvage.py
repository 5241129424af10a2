"""Pictures of a run that was interrupted: `pdcd decode --partial`.

The contents of the `.partial` are compared with its ledger, copied into a new folder and decoded
there; the `.partial` itself is never written to. Where no shot is missing the new folder is a
finished run like any other. Otherwise its manifest says "partial" and which shots are missing, and
so does `pdcd verify`.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec

from pdcd.bench.tables import Config
from pdcd.capture.job import describe_shots_taken, list_run_warnings, make_manifest, summarise_run
from pdcd.capture.worker.answers import make_developed_run
from pdcd.errors import BusyError, DecodeError, RequestError, disk_errors
from pdcd.files.inside import find_name_fault, open_folder, open_inner_file
from pdcd.files.reading import HASH_CHUNK_BYTES, hash_open_file
from pdcd.files.system import path_of
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import convert_record_errors, write_pictures
from pdcd.printable import to_one_line
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.recipes.make import narrow_to_shots
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.runs.folder import LOG, RunFolder
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.ledger import LEDGER_FILE as LEDGER
from pdcd.runs.ledger import MAX_LEDGER_BYTES, LedgerContents, read_ledger
from pdcd.runs.patterns import CODES_FILE as CODES
from pdcd.runs.place import UNFINISHED, HeldFolder
from pdcd.runs.record import FileRecord, MeterRecord, RunRecord
from pdcd.watch import Watch

_MOST_LOG_BYTES = 2**26
"""Most bytes of a log that are copied; a run of a thousand shots writes a hundredth of that."""
_TRIES = 1000
"""Names that are tried for the new folder while it is being filled."""


class _Salvaged(msgspec.Struct, frozen=True, kw_only=True):
    """The result of decoding an unfinished run.

    `state` is "done" where no shot is missing, else "partial". `lost` are RAW files that are
    missing or have changed, in words; their shots are among the `missing`.
    """

    folder: str
    job: str
    state: str
    taken: str
    """As "3 of 5 shots, missing: black, coded-4"."""
    missing: tuple[str, ...]
    lost: tuple[str, ...]
    manifest_sha256: str


@dataclass(frozen=True)
class _Sound:
    """The part of a run that is as its ledger says."""

    kept: LedgerContents
    run: RunRecord
    planned: tuple[Shot, ...]
    """All shots of the recipe, in order."""
    meter: tuple[MeterRecord, ...]
    lost: tuple[str, ...]
    frames_bytes: int
    size_bytes: int
    """Bytes of all that will be copied."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Planned shots that are not there but wanted: where a run had reached the wanted error,
        parts beyond those that it took are not."""
        there = {shot.name for shot in self.run.shots}
        taken = {entry.shot.name for entry in self.kept.taken}
        parts = {0, *(shot.part for shot in self.planned if shot.name in taken)}
        return tuple(
            shot.name
            for shot in self.planned
            if shot.name not in there and (shot.part in parts or not self.kept.enough)
        )


def decode_partial(folder: Path, out: Path | None = None, watch: Watch | None = None) -> _Salvaged:
    """Decode a `.partial` into a new folder.

    folder : the unfinished run. out : where the new folder is made; by default beside the old one.
        `watch` hears of the progress.

    Raises BusyError while the run still goes on, RequestError for a folder that is not an
    unfinished run or a name that is taken, DecodeError when its ledger, codes or frame log are
    damaged or no picture can be made of what is there, NoSpaceError and DiskError.
    """
    watch = watch or Watch()
    real = Path(os.path.realpath(folder))  # which copes with circular links, too
    if not real.name.endswith(UNFINISHED):
        raise RequestError(
            f"{to_one_line(str(folder))} is not an unfinished run",
            hint="leave out --partial for a finished one",
        )
    with _held(folder) as source:
        sound = _looked_at(source, folder, watch)
        job = sound.kept.begun.job
        name = f"{job}-partial" if sound.missing else job
        with (
            HeldFolder.at(out or real.parent) as place,
            _new(place, name, sound) as made,
        ):
            cut = _copy(source, made, sound, watch)
            return _decoded(made, folder, sound, cut, watch)


@contextmanager
def _held(folder: Path) -> Iterator[int]:
    """Descriptor of the folder, locked so that nobody fills it meanwhile. Raises BusyError,
    RequestError."""
    try:
        with open_folder(folder) as descriptor:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise BusyError(
                    f"{to_one_line(str(folder))} is still being filled",
                    hint="wait for the end of the run, or cancel it",
                ) from None
            except OSError:  # a disk without locks: nobody can tell whether the run goes on
                pass
            yield descriptor
    except (FileNotFoundError, NotADirectoryError, PermissionError) as err:
        raise RequestError(f"cannot open {to_one_line(str(folder))}: {err.strerror}") from err


def _looked_at(source: int, folder: Path, watch: Callable[[], None]) -> _Sound:
    """Check all files that the ledger names. folder : that of the descriptor `source`."""
    kept = read_ledger(source)
    fault, run = find_name_fault(kept.begun.job), kept.run
    if fault is not None or "/" in kept.begun.job:
        raise DecodeError(f"{LEDGER} names an impossible job: {fault or 'a path'}")
    if run is None or kept.planned is None:
        raise DecodeError("the run ended before its first exposure", hint="capture again")
    wrong = _fault_in(source, CODES, kept.planned.codes, watch)
    if wrong is not None:
        raise DecodeError(f"{CODES}: {wrong}", hint="restore it from a copy")
    frames_bytes = _check_frames(source, kept, watch)
    shots, meter, size = [], [], frames_bytes + kept.planned.codes.size_bytes
    lost: dict[str, str] = {}
    for shot in run.shots:
        wrong = _fault_in(source, shot.raw, FileRecord(shot.sha256, shot.size_bytes), watch)
        if wrong is None:
            shots.append(shot)
            size += shot.size_bytes
        else:
            lost[shot.raw] = wrong
    for test in kept.metered:
        wrong = _fault_in(source, test.meter.raw, test.file, watch)
        if wrong is None:
            meter.append(test.meter)
            size += test.file.size_bytes
        else:
            lost[test.meter.raw] = wrong
    with convert_record_errors(folder):
        recipe = Darkroom(path_of(source), run).recipe
        # Where a run went on with other codes, earlier shots no longer belong to it.
        known = {shot.name for shot in recipe.shots}
        shots = [shot for shot in shots if shot.name in known]
        made = narrow_to_shots(recipe, {shot.name for shot in shots})
        if not made.pictures:
            planned = [shot.name for shot in recipe.shots]
            missing = [n for n in planned if n not in {shot.name for shot in shots}]
            raise DecodeError(
                "no picture can be made of what is there: "
                + describe_shots_taken(len(shots), len(planned), missing),
                hint="capture again",
            )
        _refuse_lost(run, made, lost)
        there = {test.raw for test in meter}
        dark = run.dark if run.dark and run.dark.raw in there else None
        borders = run.borders
        if borders and not {borders.raw, borders.dark.raw} <= there:
            borders = None
        run = msgspec.structs.replace(run, shots=tuple(shots), dark=dark, borders=borders)
    return _Sound(
        kept=kept,
        run=run,
        planned=recipe.shots,
        meter=tuple(meter),
        lost=tuple(f"{to_one_line(raw)}: {wrong}" for raw, wrong in lost.items()),
        frames_bytes=frames_bytes,
        size_bytes=size,
    )


def _refuse_lost(run: RunRecord, made: Recipe, lost: Mapping[str, str]) -> None:
    """Raise DecodeError where a photo is lost on which the pictures depend although it is none of
    their shots: of the room's light, or of a pilot."""
    needed = [] if run.room is None else [run.room.raw]
    if any(photo.paths for photo in made.photos):
        needed += [shot.raw for shot in run.shots if shot.name in made.stack]
    for raw in needed:
        if raw in lost:
            raise DecodeError(
                f"no picture can be made without {to_one_line(raw)}: {lost[raw]}",
                hint="restore it from a copy, or capture again",
            )


def _check_frames(source: int, kept: LedgerContents, watch: Callable[[], None]) -> int:
    """Bytes of frames.csv that belong to shots. Raises DecodeError where any of them changed."""
    at = 0
    try:
        with open_inner_file(source, FRAMES) as descriptor:
            for entry in kept.taken:
                size = entry.frames.size_bytes
                if hash_open_file(descriptor, watch, size)[0] != entry.frames.sha256:
                    raise DecodeError("it is not as it was written")
                at += size
    except FileNotFoundError:
        if kept.taken:
            raise DecodeError(f"{FRAMES} is missing", hint="restore it from a copy") from None
    except (OSError, DecodeError) as err:
        words = err.message if isinstance(err, DecodeError) else err.strerror
        raise DecodeError(f"{FRAMES}: {words}", hint="restore it from a copy") from err
    return at


def _fault_in(source: int, name: str, wanted: FileRecord, watch: Callable[[], None]) -> str | None:
    """What is wrong with a file; None when it is as the ledger says."""
    fault = find_name_fault(name)
    if fault is not None:
        return fault
    try:
        with open_inner_file(source, name) as descriptor:
            if os.fstat(descriptor).st_size != wanted.size_bytes:
                return "it has another size"
            same = hash_open_file(descriptor, watch, wanted.size_bytes)[0] == wanted.sha256
            return None if same else "it does not have the SHA-256 that it was stored with"
    except FileNotFoundError:
        return "it is missing"
    except (OSError, DecodeError) as err:
        return err.message if isinstance(err, DecodeError) else str(err.strerror)


@contextmanager
def _new(place: HeldFolder, name: str, sound: _Sound) -> Iterator[RunFolder]:
    """The folder to be filled, under a name that is not taken for a run's. Raises RequestError
    where its final name is taken."""
    if os.path.lexists(place.path / name):
        raise RequestError(
            f"{place.real / name} is there already",
            hint="an earlier decoding may have made it; --out puts another one elsewhere",
        )
    for number in range(1, _TRIES):
        unfinished = f"{name}-decoded-{number}{UNFINISHED}"
        if not (place.path / unfinished).exists():
            break
    with RunFolder(place, name, unfinished=unfinished) as made:
        made.create(min_free_bytes=sound.size_bytes)
        yield made


def _copy(
    source: int, made: RunFolder, sound: _Sound, watch: Callable[[], None]
) -> tuple[str, ...]:
    """Copy what is sound; its contents are checked again when they are decoded. Returns what was
    left out, in words."""
    planned = sound.kept.planned
    sizes = {} if planned is None else {CODES: planned.codes.size_bytes}
    sizes |= {shot.raw: shot.size_bytes for shot in sound.run.shots}
    metered = {test.meter.raw: test.file.size_bytes for test in sound.kept.metered}
    sizes |= {test.raw: metered[test.raw] for test in sound.meter}
    sizes |= {FRAMES: sound.frames_bytes, LEDGER: MAX_LEDGER_BYTES, LOG: _MOST_LOG_BYTES}
    for name, most_bytes in sizes.items():
        _copy_file(source, name, made.path / name, most_bytes, watch)
    whole = os.stat(LOG, dir_fd=source, follow_symlinks=False).st_size
    if whole <= _MOST_LOG_BYTES:
        return ()
    return (f"left out: all but the first {_MOST_LOG_BYTES} of {whole} bytes of {LOG}",)


def _copy_file(
    source: int, name: str, target: Path, most_bytes: int, watch: Callable[[], None]
) -> None:
    with (
        disk_errors(name),
        open_inner_file(source, name) as descriptor,
        target.open("xb") as copy,
    ):
        while most_bytes and (chunk := os.read(descriptor, min(most_bytes, HASH_CHUNK_BYTES))):
            copy.write(chunk)
            most_bytes -= len(chunk)
            watch()


def _decoded(
    made: RunFolder, folder: Path, sound: _Sound, cut: tuple[str, ...], watch: Watch
) -> _Salvaged:
    """Decode in the new folder, and finish it. folder : of the unfinished run. cut : what of it was
    left out."""
    kept = sound.kept
    with convert_record_errors(folder):
        darkroom = Darkroom(made.path, sound.run)
        decoded = darkroom.decoded(watch, partly=bool(sound.missing))
        told = write_pictures(made.path, decoded)
        developed = make_developed_run(darkroom.record, decoded, (None, None), told, watch)
        plan = kept.planned.plan if kept.planned else {}
        summary = summarise_run(msgspec.convert(plan, PlanSummary), developed)
        config = msgspec.convert(kept.begun.config, Config, strict=False)
    known = list_run_warnings(developed, config, sound.run.profile, mock=kept.begun.mock)
    taken = describe_shots_taken(len(sound.run.shots), len(sound.planned), sound.missing)
    summary["taken"] = taken
    warnings = [*dict.fromkeys((*kept.warnings, *known)), f"decoded after an interruption: {taken}"]
    warnings += [*(f"left out: {text}" for text in sound.lost), *cut]
    warnings += _lacks(darkroom.recipe, decoded.recipe)
    manifest = make_manifest(
        kept.begun,
        plan,
        developed,
        summary=summary,
        warnings=warnings,
        meter=sound.meter,
        files=made.hashes(watch),
        missing=sound.missing,
    )
    digest = made.finish(manifest)
    return _Salvaged(
        folder=str(made.where),
        job=kept.begun.job,
        state=manifest.state,
        taken=taken,
        missing=sound.missing,
        lost=sound.lost,
        manifest_sha256=digest,
    )


def _lacks(planned: Recipe, made: Recipe) -> Iterator[str]:
    """Warnings for pictures that were made of fewer shots than planned."""
    terms = {photo.name: len(photo.shots) for photo in planned.photos}
    for photo in made.photos:
        if len(photo.shots) < terms[photo.name]:
            yield f"photo {photo.name} is made of {len(photo.shots)} of {terms[photo.name]} shots"
    if made.answer_name != planned.answer_name:
        yield f"the answer is missing; {made.answer_name} stands in its place"
