"""Is a run folder complete and unchanged? Every byte of it is compared with the manifest.

The manifest itself is compared with the digest beside it (`pdcd.runs.manifest`), its entries with
their types and with each other, and the folder with its list of files. The contents of the folder
are never trusted: see `pdcd.files.inside`.
"""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from errno import ELOOP, ENOTDIR
from pathlib import Path
from typing import Literal

import msgspec

from pdcd.bench.calibration import format_digest_line
from pdcd.errors import DecodeError
from pdcd.files.inside import (
    find_name_fault,
    list_folder,
    open_folder,
    open_inner_file,
    read_inner_file,
)
from pdcd.files.reading import hash_open_file
from pdcd.files.system import path_of
from pdcd.printable import to_one_line
from pdcd.protocol.result import quality_of
from pdcd.runs.folder import LOG, is_made_later
from pdcd.runs.frame_table import FRAMES_FILE as FRAMES
from pdcd.runs.manifest import (
    MANIFEST,
    MANIFEST_DIGEST,
    MAX_MANIFEST_BYTES,
    OtherSchemaError,
    parse_manifest,
)
from pdcd.runs.patterns import CODES_FILE as CODES
from pdcd.runs.record import FileRecord, Manifest

PROBE = "probe.npz"
"""The answer over the cells, with its error."""
_NEEDED = (CODES, FRAMES, PROBE, LOG)
"""Files that every run has, in addition to the RAW files of its shots."""
MAX_FINDINGS, MAX_WORDS = 1000, 300
"""Most findings for one folder, and most characters of each."""
_MOST_LOOKED = 10_000
"""Most names in a folder that are searched for a run."""
MAX_CELLS = 2**24
"""Most code cells of a run: more than any panel has pixels."""

_What = Literal["missing", "changed", "unknown", "manifest", "unreadable", "partial"]
_Alive = Callable[[], object]


class FolderFinding(msgspec.Struct, frozen=True):
    """Something that is not as it was: which file of the folder, what is wrong, and how.

    missing: listed, but not there. changed: other contents, or no regular file. unknown: there, but
    not listed. manifest: capture.json is inconsistent. unreadable: the disk or the permissions do
    not allow reading it. partial: planned shots are not in the run, which is otherwise unchanged.
    """

    path: str
    what: _What
    detail: str


class VerifyReport(msgspec.Struct, frozen=True, kw_only=True):
    """What was found in a run folder; `whole` when nothing was."""

    folder: str
    whole: bool
    job: str | None
    schema: int | None
    manifest_sha256: str | None
    """SHA-256 of capture.json as it is; None where it cannot be read."""
    files: int
    """Files that are as the manifest says."""
    size_bytes: int
    """Bytes of these files together."""
    findings: tuple[FolderFinding, ...]
    not_kept: tuple[str, ...] = ()
    """RAW files that the run did not keep: they are not there, so their digests are not checked."""
    later: tuple[str, ...] = ()
    """Files that were made after the run had ended, to be looked at (`pdcd.runs.folder`). Nothing
    vouches for them, and nothing depends on them."""


def verify_run(folder: Path, *, manifest_sha256: str | None = None) -> VerifyReport:
    """Check all of a run folder. Faults are in the report, never raised.

    `manifest_sha256` is the expected digest of the manifest, where that is known from elsewhere.
    """
    check = FolderCheck()
    check.look(folder, manifest_sha256, None)
    found = check.found
    return VerifyReport(
        folder=to_one_line(str(folder)),
        whole=not found,
        job=None if check.read is None else check.read.job,
        schema=None if check.read is None else check.read.schema,
        manifest_sha256=check.sha256,
        files=check.sound,
        size_bytes=check.size_bytes,
        findings=tuple(found),
        not_kept=tuple(sorted(check.absent)),
        later=tuple(check.later),
    )


def read_whole_manifest(
    folder: Path, names: Collection[str] | None = None, alive: _Alive = lambda: None
) -> Manifest:
    """The manifest of a run of which nothing has changed; with `names`, none of these files.

    `alive` is called now and then, and may raise to end the work. Raises DecodeError, which says
    what has changed.
    """
    return _manifest(folder, names, alive, ())


def read_sound_manifest(
    folder: Path, names: Collection[str], alive: _Alive = lambda: None
) -> Manifest:
    """The same, also for a run with missing shots that is otherwise unchanged."""
    return _manifest(folder, names, alive, ("partial",))


def _manifest(
    folder: Path, names: Collection[str] | None, alive: _Alive, allowed: tuple[_What, ...]
) -> Manifest:
    check = FolderCheck(alive)
    check.look(folder, None, names)
    if check.other_schema is not None:
        raise check.other_schema
    found = [finding for finding in check.found if finding.what not in allowed]
    if check.read is None or found:
        first = found[0]
        if check.read is None and first.what in ("missing", "unreadable"):
            raise _make_absent_error(folder, first)
        more = f", and {len(found) - 1} more" if len(found) > 1 else ""
        raise DecodeError(
            f"{to_one_line(str(folder))} is not a whole and unchanged run: {first.path}: "
            f"{first.detail}{more}",
            hint="see pdcd verify; restore it from a copy",
        )
    return check.read


def _make_absent_error(folder: Path, why: FolderFinding) -> DecodeError:
    """The error for a folder whose manifest cannot be read, or for something that is not a
    folder."""
    called, hint = to_one_line(str(folder)), "see pdcd runs for those there are"
    if os.path.isfile(folder):  # noqa: PTH113 - pathlib raises for names that are too long
        hint = "name the folder that it lies in"
        return DecodeError(f"{called} is a file, no run folder", hint=hint)
    inside = find_inner_run(folder)
    if inside is not None:
        hint = f"name one of them, such as {to_one_line(str(folder / inside))}"
        return DecodeError(f"{called} holds runs and is not a run itself", hint=hint)
    if why.what == "missing":
        hint += "; pdcd decode --partial makes what it can of an interrupted one"
        return DecodeError(f"{called} is no finished run: it has no {MANIFEST}", hint=hint)
    return DecodeError(f"{called} cannot be read: {why.path}: {why.detail}", hint=hint)


def find_inner_run(folder: Path) -> str | None:
    """Name of the last run, by name, in a folder; None where there is none."""
    try:
        with os.scandir(folder) as listed:
            names = sorted((e.name for e in itertools.islice(listed, _MOST_LOOKED)), reverse=True)
        return next((name for name in names if (folder / name / MANIFEST).is_file()), None)
    except (OSError, ValueError):
        return None


class FolderCheck:
    """One check of one folder."""

    own = (MANIFEST, MANIFEST_DIGEST)
    """The files that list all others and vouch for them."""
    most_bytes = MAX_MANIFEST_BYTES
    folders = frozenset({"raw", "linear", "preview"})
    """Folders that may be empty."""
    none = "this is no finished run"
    """The finding where nothing lists the files."""

    def __init__(self, alive: _Alive = lambda: None) -> None:
        self._alive = alive
        self.read: Manifest | None = None
        self.other_schema: OtherSchemaError | None = None
        self.sha256: str | None = None
        self.found: list[FolderFinding] = []
        self.sound = 0
        self.size_bytes = 0
        self.later: list[str] = []
        self.absent: list[str] = []

    def find(self, name: str, what: _What, detail: str) -> None:
        """Note what is wrong with a file."""
        if len(self.found) < MAX_FINDINGS:
            # A forged manifest may have words of any length.
            self.found.append(
                FolderFinding(to_one_line(name[:MAX_WORDS]), what, detail[:MAX_WORDS])
            )

    def look(self, folder: Path, expected: str | None, names: Collection[str] | None) -> None:
        """Check the manifest and the files of these names, or everything that is there."""
        try:
            if folder.resolve().name.endswith(".partial"):
                self.find(".", "manifest", "its name says that the run was not finished")
            with open_folder(folder) as descriptor:
                self.manifest(descriptor, expected)
                self.files(descriptor, names)
        except (OSError, ValueError, RuntimeError, DecodeError) as err:
            self.find(".", "unreadable", _words(err))

    def manifest(self, folder: int, expected_sha256: str | None) -> None:
        """Read the manifest, compare it with its digest and check its consistency."""
        name = self.own[0]
        try:
            data = read_inner_file(folder, name, self.most_bytes)
        except FileNotFoundError:
            inside = find_inner_run(path_of(folder))
            such = f"; this folder holds runs, such as {inside}" if inside else ""
            self.find(name, "missing", self.none + such)
            return
        except (OSError, DecodeError) as err:
            self.find(name, _what(err), _words(err))
            return
        self.sha256 = hashlib.sha256(data).hexdigest()
        if expected_sha256 is not None and expected_sha256.lower() != self.sha256:
            self.find(name, "manifest", f"its SHA-256 is {self.sha256}, not the one given")
        self.understand(data, vouched=self._digest(folder, data))

    def understand(self, data: bytes, *, vouched: bool) -> None:
        """Check the manifest's consistency; `vouched` is whether there is a digest of it."""
        try:
            self.read = parse_manifest(data)
        except DecodeError as err:
            self.find(MANIFEST, "manifest", err.message)
            self.other_schema = err if isinstance(err, OtherSchemaError) else None
            return
        if not vouched:
            self.find(MANIFEST_DIGEST, "missing", "nothing vouches for the manifest")
        if self.read.state == "partial":
            missing = [to_one_line(name) for name in self.read.missing]
            self.find(".", "partial", f"not all shots are there, missing: {', '.join(missing)}")
        for what in _contradictions(self.read):
            self.find(MANIFEST, "manifest", what)

    def _digest(self, folder: int, data: bytes) -> bool:
        """Whether there is a digest; a wrong one is noted."""
        name, digest = self.own
        wanted = format_digest_line(data, name)
        try:
            if read_inner_file(folder, digest, len(wanted)) != wanted:
                self.find(name, "manifest", f"it does not have the SHA-256 that {digest} holds")
        except FileNotFoundError:
            return False
        except (OSError, DecodeError) as err:
            self.find(digest, _what(err), _words(err))
        return True

    def may_come_later(self, name: str) -> bool:
        """Whether a file may be there without being listed."""
        return is_made_later(name)

    @property
    def listed(self) -> Mapping[str, FileRecord] | None:
        """All files that should be there; None where nothing lists them."""
        return None if self.read is None else {**self.read.unkept, **self.read.files}

    def files(self, folder: int, names: Collection[str] | None = None) -> None:
        """Compare the folder with the files that the manifest lists; with `names`, only these."""
        listed = self.listed
        if listed is None:
            return
        if names is None:
            self._compare(listed, list_folder(folder))
        for name in sorted(listed) if names is None else names:
            if name not in listed:
                self.find(name, "manifest", "the manifest does not list it")
            elif find_name_fault(name) is None:
                self._file(folder, name, listed[name])

    def _compare(self, listed: Collection[str], there: dict[str, str]) -> None:
        """Note what is there but not listed."""
        folders = set(self.folders)
        for name in listed:
            folders.update(name[:at] for at, letter in enumerate(name) if letter == "/")
        for name, kind in sorted(there.items()):
            known = name in listed or name in self.own
            if not known and kind == "file" and self.may_come_later(name):
                self.later.append(name)
            elif not (known or (kind == "folder" and name in folders)):
                self.find(name, "unknown", f"a {kind} that the manifest does not list")

    def _file(self, folder: int, name: str, wanted: FileRecord) -> None:
        try:
            with open_inner_file(folder, name) as descriptor:
                self._content(descriptor, name, wanted)
        except FileNotFoundError:
            if self.read is not None and name in self.read.unkept:
                self.absent.append(name)
            else:
                self.find(name, "missing", "the manifest lists it")
        except (OSError, DecodeError) as err:
            self.find(name, _what(err), _words(err))

    def _content(self, descriptor: int, name: str, wanted: FileRecord) -> None:
        # The size is checked before the file is read: a wrong file may be of any length.
        size = os.fstat(descriptor).st_size
        if size != wanted.size_bytes:
            self.find(name, "changed", f"it has {size} bytes, not {wanted.size_bytes}")
        elif hash_open_file(descriptor, self._alive)[0] != wanted.sha256:
            self.find(name, "changed", "it does not have the SHA-256 that the manifest names")
        else:
            self.sound += 1
            self.size_bytes += size
        self._alive()


def _contradictions(manifest: Manifest) -> Iterator[str]:
    """Contradictions in the manifest, in words."""
    run, files = manifest.run, {**manifest.unkept, **manifest.files}
    for name in manifest.unkept:
        if name in manifest.files or not name.startswith("raw/"):
            yield f"{to_one_line(name)!r} was not kept and is listed, or is no RAW file"
    if manifest.state not in ("done", "partial"):
        yield f"its state is {manifest.state!r}"
    if (manifest.state == "partial") != bool(manifest.missing):
        yield f"its state is {manifest.state!r}, and {len(manifest.missing)} shots are missing"
    if run.grid[0] * run.grid[1] > MAX_CELLS:
        yield f"a grid of {run.grid[0]} x {run.grid[1]} cells"
    if run.cells is not None and run.cells.grid != run.grid:
        yield "its map of cells is of another grid"
    folded: dict[str, str] = {}
    for name in files:
        fault = (
            "it vouches for itself"
            if name in (MANIFEST, MANIFEST_DIGEST)
            else find_name_fault(name)
        )
        if fault is not None:
            yield f"file {to_one_line(name)!r}: {fault}"
        other = folded.setdefault(name.casefold(), name)
        if other != name:
            yield f"{to_one_line(name)!r} and {to_one_line(other)!r} differ in case only"
    if quality_of(manifest.summary) is None:
        yield "it has no verdict"
    shots = [shot.name for shot in run.shots]
    if len(set(shots)) != len(shots):
        yield "it has two shots of one name"
    for name in (*_NEEDED, *(test.raw for test in manifest.meter)):
        if name not in files:
            yield f"it does not list {to_one_line(name)!r}"
    borders = run.borders
    for photo, what in (
        (run.dark, "dark photo"),
        (borders, "photo of borders"),
        (borders and borders.dark, "dark photo of borders"),
    ):
        if photo and (photo.raw not in files or files[photo.raw].sha256 != photo.sha256):
            yield f"its {what} and the list of files name another RAW file"
    for shot in run.shots:
        if shot.raw not in files or files[shot.raw].sha256 != shot.sha256:
            yield f"shot {to_one_line(shot.name)!r} and the list of files name another RAW file"
        if not shot.open_ns < shot.close_ns:
            yield f"shot {to_one_line(shot.name)!r} closed before it opened"


def _what(err: Exception) -> _What:
    # The system itself refuses a link or a file where a folder is expected.
    changed = isinstance(err, DecodeError) or getattr(err, "errno", 0) in (ELOOP, ENOTDIR)
    return "changed" if changed else "unreadable"


def _words(err: Exception) -> str:
    if isinstance(err, OSError):
        return err.strerror or str(err)
    return err.message if isinstance(err, DecodeError) else str(err)
