"""The pictures of a run folder: written once by the capture, made again to compare."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np

from pdcd.errors import ConfigError, DecodeError, PdcdError, disk_errors
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import MAX_PICTURE_BYTES, hash_file
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.transport import TransportSlice, draw_transport_slice
from pdcd.pictures.written.picture_files import write_png, write_tiff
from pdcd.pictures.written.previews import write_previews
from pdcd.protocol.plan_summary import Goal
from pdcd.runs.verify import PROBE, read_whole_manifest
from pdcd.watch import Watch

TRANSPORT = "transport.npz"
TRANSPORT_PICTURE = "preview/transport.png"


class ComparedFile(msgspec.Struct, frozen=True):
    """One picture: its path in the run folder, and whether it came out byte for byte the same."""

    name: str
    identical: bool


class RunComparison(msgspec.Struct, frozen=True):
    """What came out when a run was decoded again."""

    identical: bool
    """Whether all pictures came out the same."""
    files: tuple[ComparedFile, ...]


def write_pictures(folder: Path, decoded: DecodedRun) -> tuple[str, ...]:
    """Write linear/*.tif, probe.npz and preview/*.png below `folder`; returns warnings.

    The TIFFs have the camera's own geometry and resolution, `probe.npz` has means over the cells.
    Entries of T that were photographed go to transport.npz, and to preview/transport.png.

    Raises NoSpaceError, or DiskError for any other refusal of the disk.
    """
    with disk_errors(str(folder)):
        means = decoded.cell_means
        with (folder / PROBE).open("wb") as file:
            np.savez(
                file,
                image=means.image,
                sigma=means.sigma,
                sigma_sensor=means.sensor,
                sigma_code=means.code,
                sigma_kind=np.array(means.kind),
            )
        if decoded.transport is not None:
            _write_transport(folder, decoded.transport, decoded.recipe.target.goal)
        # Both are mostly compressing and copying, which a second core can do meanwhile.
        with ThreadPoolExecutor(1) as pool:
            written = [
                pool.submit(write_tiff, folder / "linear" / f"{name}.tif", picture.image)
                for name, picture in decoded.pictures.items()
            ]
            warnings = write_previews(folder / "preview", decoded.pictures, decoded.view)
            for written_file in written:
                written_file.result()
        return warnings


def _write_transport(folder: Path, found: TransportSlice, goal: Goal) -> None:
    with (folder / TRANSPORT).open("wb") as file:
        np.savez(
            file,
            transport=found.entries,
            sigma=found.sigma,
            camera_cells=found.seen,
            projector_cells=found.lit,
            photos=np.array(found.photos),
            uneven=np.array(found.uneven),
        )
    where = "all of T"
    if goal.rows is not None:
        where = f"T: camera row {goal.rows[1]}, projector row {goal.rows[0]}"
    write_png(folder / TRANSPORT_PICTURE, draw_transport_slice(found, where))


@contextmanager
def convert_record_errors(folder: Path) -> Iterator[None]:
    """Turn whatever a forged record makes of the decoding into DecodeError.

    Sound bytes may hold a record that no capture would write: shots that the goal does not have,
    panels that do not fit the codes.
    """
    try:
        yield
    except ConfigError as err:
        raise DecodeError(f"{folder}: its record is wrong: {err.message}", hint=err.hint) from err
    except (PdcdError, OSError):  # the latter of the scratch folder; a run's own files are typed
        raise
    except Exception as err:
        raise DecodeError(
            f"{folder}: its record does not fit its files: {type(err).__name__}: {err}",
            hint="if pdcd wrote this run, this is a fault of the program",
        ) from err


def decode_folder(folder: Path, watch: Watch | None = None) -> RunComparison:
    """Decode a finished run again and compare with the TIFFs it holds.

    `watch` gets the progress. Raises DecodeError when the folder is not a finished run, or when
    anything in it has changed (`pdcd.runs.verify`); nothing is decoded then.
    """
    watch = watch or Watch()
    manifest = read_whole_manifest(folder, alive=watch)
    manifest.require_photos()
    run = manifest.run
    with (
        convert_record_errors(folder),
        tempfile.TemporaryDirectory(prefix="pdcd-decode-") as scratch,
    ):
        decoded = Darkroom(folder, run).decoded(watch)
        again = Path(scratch)
        for name in ("linear", "preview"):
            (again / name).mkdir()
        write_pictures(again, decoded)
        names = [f"linear/{path.name}" for path in sorted((again / "linear").iterdir())]
        if (again / TRANSPORT).is_file():
            names.append(TRANSPORT)
        files = [ComparedFile(name, _is_same(folder / name, again / name)) for name in names]
    return RunComparison(all(file.identical for file in files), tuple(files))


def _is_same(kept: Path, made: Path) -> bool:
    try:
        return hash_file(kept, MAX_PICTURE_BYTES) == hash_file(made, MAX_PICTURE_BYTES)
    except UnsoundFileError:
        return False
