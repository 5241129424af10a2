"""From the RAW files, codes and frame log of a run to its pictures; the only way pictures are made.

A capture ends here and `pdcd decode` starts here, so what a run folder shows can always be made
again from what it holds, bit for bit.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import Homography
from pdcd.errors import DecodeError, disk_errors
from pdcd.frames.patterns import Patterns, none
from pdcd.pictures import work
from pdcd.pictures.combine import Exposed, Picture, pictures_of, realised_photo, scaled_photos
from pdcd.pictures.develop import preview, warp, write_png, write_tiff
from pdcd.pictures.learn import Learned, corrections, learn
from pdcd.pictures.sigma import Barred, measured
from pdcd.pictures.sigma_model import modelled
from pdcd.pictures.smooth import smoothed
from pdcd.pictures.software import software_sums
from pdcd.pictures.watch import Watch
from pdcd.probing.deviation import Deviation, deviation, weight_s
from pdcd.probing.realised import Factors, bench_factors, collect, shared
from pdcd.recipes.goals import MATRICES, PLANES, Goal
from pdcd.recipes.make import make_recipe
from pdcd.recipes.parts import FEWEST_PARTS, in_parts, only_parts, part_numbers, taken_parts
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.recipes.repeat import repeated
from pdcd.runs.folder import read_frames, read_manifest, read_patterns, sha256_of
from pdcd.runs.record import RunRecord, ShotRecord
from pdcd.sensor.raw import read_raw, rgb_variance, to_rgb


@dataclass(frozen=True)
class Decoded:
    """All pictures of a run by name, the answer first, and the shots they were made from."""

    recipe: Recipe
    shots: dict[str, Exposed]
    pictures: dict[str, Barred]
    learned: Learned | None = None
    sums: dict[str, Exposed] = field(default_factory=dict)
    """Weighted sums of single photos, which the recipe's photos name like shots."""

    def deviations(self, watch: Watch | None = None) -> dict[str, Deviation]:
        """For each photo, its realised probing matrix against the wanted one."""
        watch = Watch() if watch is None else watch
        found = {}
        for photo in self.recipe.photos:
            realised = realised_photo(photo.shots, {**self.shots, **self.sums})
            with watch.piece(work.comparing(photo), work.signs_of_comparing([photo])) as alive:
                found[photo.name] = deviation(realised, photo.wanted, alive)
        return found


def decode(
    folder: Path,
    record: RunRecord,
    watch: Watch | None = None,
    *,
    known: Mapping[str, Exposed] | None = None,
    report: bool = False,
) -> Decoded:
    """Read everything below `folder` and compute the pictures; nothing is written.

    `watch` is told how far it is, and may end the work. With `report` it is to expect
    `Decoded.deviations` as well. Shots that are `known` already, by name, are not read again.
    """
    watch = Watch() if watch is None else watch
    stored = read_patterns(folder)
    recipe = make_recipe(
        _goal(record, stored),
        black_level=record.black_level,
        white=record.white,
        codes=record.codes,
        pilot=record.pilot,
        method=record.method,
    )
    recipe = in_parts(recipe, record.parts)
    recipe = repeated(recipe, record.repeat)
    by_name = {shot.name: shot for shot in recipe.shots}
    shots = dict(known or {})
    recipe = taken_parts(recipe, {*shots, *(shot.name for shot in record.shots)})
    unread = [shot for shot in record.shots if shot.name not in shots]
    watch.expect(work.decoding(recipe, record, unread, report=report))
    for shot in unread:
        pair = _pair(stored, by_name[shot.name])
        with watch.piece(work.reading(shot)) as alive:
            shots[shot.name] = _expose(folder, record, shot, pair, alive)
    learned = None
    if record.pilot:
        learned = learn(recipe, shots, _bits(stored, recipe, "pilot"), record.codes + record.pilot)
    sums = {}
    if recipe.sums and all(name in shots for name in recipe.stack):
        program = "pilot" if record.pilot else "photos"
        sums = software_sums(recipe, shots, _bits(stored, recipe, program))
    exposed = {**shots, **sums}
    if not all(name in exposed for photo in recipe.photos for _, name in photo.shots):
        return Decoded(recipe, shots, {}, learned)  # a run in the middle, which wants to learn
    pictures = _barred(recipe, exposed, learned, record, watch)
    if record.homography is not None:
        pictures = {name: _warped(p, record.homography) for name, p in pictures.items()}
    return Decoded(recipe, shots, pictures, learned, sums)


def write_pictures(folder: Path, decoded: Decoded) -> None:
    """Write linear/*.tif, probe.npz and preview/*.png below `folder`.

    All previews share one exposure scale, that of the brightest picture, so that they compare.
    """
    with disk_errors(str(folder)):
        answer = next(iter(decoded.pictures.values()))
        with (folder / "probe.npz").open("wb") as file:
            np.savez(
                file,
                image=answer.image,
                sigma=answer.sigma,
                sigma_sensor=answer.sensor,
                sigma_code=answer.code,
                sigma_kind=np.array(answer.kind),
            )
        brightest = max(float(np.percentile(p.image, 99.0)) for p in decoded.pictures.values())
        scale = 0.9 / brightest if brightest > 0.0 else 1.0
        for name, picture in decoded.pictures.items():
            write_tiff(folder / "linear" / f"{name}.tif", picture.image.astype(np.float32))
            shown = preview(picture.image, exposure=scale)
            write_png(folder / "preview" / f"{name}.png", shown)


def decode_folder(folder: Path, watch: Watch | None = None) -> dict[str, Any]:
    """Decode a finished run again and compare with the TIFFs it holds.

    Returns ``{"identical": bool, "files": [{"name", "identical"}, ...]}``. Raises DecodeError when
    the folder is not a finished run or its files are damaged.
    """
    manifest = read_manifest(folder)
    decoded = decode(folder, manifest.run, watch)
    with tempfile.TemporaryDirectory(prefix="pdcd-decode-") as scratch:
        again = Path(scratch)
        for name in ("linear", "preview"):
            (again / name).mkdir()
        write_pictures(again, decoded)
        files = []
        for path in sorted((again / "linear").iterdir()):
            kept = folder / "linear" / path.name
            same = kept.is_file() and sha256_of(kept) == sha256_of(path)
            files.append({"name": f"linear/{path.name}", "identical": same})
    return {"identical": all(f["identical"] for f in files), "files": files}


def _goal(record: RunRecord, stored: dict[str, NDArray[Any]]) -> Goal:
    """The goal of a run, its arrays as they were stored with it."""
    arrays = {key[5:]: value for key, value in stored.items() if key.startswith("goal.")}
    return Goal(
        name=record.goal,
        grid=record.grid,
        p=record.p,
        shift=record.shift,
        radius=record.radius,
        mix=record.mix,
        period=record.period,
        planes={name: a for name, a in arrays.items() if name in PLANES},
        matrices={name: a for name, a in arrays.items() if name in MATRICES},
    )


def _pair(stored: dict[str, NDArray[Any]], shot: Shot) -> tuple[Patterns, Patterns]:
    """Patterns of a shot; none for a white one."""
    if shot.white:
        return none(), none()
    try:
        pair = stored[f"{shot.program}.primal"], stored[f"{shot.program}.dual"]
    except KeyError as err:
        raise DecodeError(
            f"codes.npz lacks the patterns of {shot.program}", hint="restore it from a copy"
        ) from err
    if shot.only is None:
        return pair
    return pair[0][shot.only : shot.only + 1], pair[1][shot.only : shot.only + 1]


def _bits(stored: dict[str, NDArray[Any]], recipe: Recipe, program: str) -> NDArray[np.bool_]:
    """What the projector showed in the single-code photos, (K, N)."""
    cells = recipe.goal.grid[0] * recipe.goal.grid[1]
    return np.unpackbits(stored[f"{program}.primal"], axis=1, count=cells).astype(np.bool_)


def _missing(
    recipe: Recipe, shots: dict[str, Exposed], learned: Learned | None
) -> dict[str, NDArray[np.float64]]:
    """What the coded photo gets wrong of the paths that a pilot found."""
    if learned is None:
        return {}
    photo = next(p for p in recipe.photos if p.name == "coded")
    realised = realised_photo(photo.shots, shots)
    cells = corrections(learned, realised, weight_s(realised, photo.wanted))
    height, width = shots[photo.shots[0][1]].light.shape[:2]
    rows, cols = recipe.goal.grid
    image = cells.reshape(rows, cols, 3)
    return {"coded": image.repeat(height // rows, axis=0).repeat(width // cols, axis=1)}


def _expose(
    folder: Path,
    record: RunRecord,
    shot: ShotRecord,
    pair: tuple[Patterns, Patterns],
    alive: Callable[[], None],
) -> Exposed:
    frames, log = read_frames(folder, shot, pair, grid=record.grid)
    alive()
    chunks = bench_factors(
        frames,
        log,
        record.projector,
        record.mask,
        open_ns=shot.open_ns,
        close_ns=shot.close_ns,
    )
    realised = collect(_watched(chunks, alive))
    profile = record.profile
    raw = read_raw(
        folder / shot.raw,
        sha256=shot.sha256,
        size_bytes=shot.size_bytes,
        saturation_dn=profile.saturation_dn(shot.iso),
    )
    gain = profile.row(shot.iso).gain_e_per_dn
    # From DN to scene units times seconds: electrons, then the camera's calibrated responsivity.
    to_units = gain * shot.f_number**2 / np.array(record.responsivity_e)
    exposure_s = (shot.close_ns - shot.open_ns) * 1e-9
    level = shot.level or 1.0
    return Exposed(
        light=to_rgb(raw.planes) * (to_units / level),
        variance=rgb_variance(raw.planes, profile, shot.iso, exposure_s) * (to_units / level) ** 2,
        saturated=raw.saturated,
        realised=realised if level == 1.0 else shared(realised, level),
        exif=raw.exif(),
        missed=shot.missed if shot.level is None else 0,
    )


def _watched(chunks: Iterator[Factors], alive: Callable[[], None]) -> Iterator[Factors]:
    for chunk in chunks:
        alive()
        yield chunk


def _barred(
    recipe: Recipe,
    shots: dict[str, Exposed],
    learned: Learned | None,
    record: RunRecord,
    watch: Watch,
) -> dict[str, Barred]:
    """All pictures with sensor and code error: of what the parts show, if there are enough."""

    def photos(part: Recipe) -> dict[str, Picture]:
        added = _missing(part, shots, learned)
        scaled = scaled_photos(part, shots, added, normalise=record.normalise)
        if record.smooth and "coded" in scaled:
            signs = work.signs_of_smoothing(part, shots)
            with watch.piece(work.smoothing(part, record), signs) as alive:
                scaled["coded"] = smoothed(
                    part,
                    shots,
                    scaled["coded"],
                    learned,
                    normalise=record.normalise,
                    alive=alive,
                )
        return scaled

    scaled = photos(recipe)
    whole = pictures_of(recipe, scaled)
    numbers = part_numbers(recipe)
    if len(numbers) < FEWEST_PARTS:
        units = sum(map(work.comparing, recipe.photos))
        with watch.piece(units, work.signs_of_comparing(recipe.photos)) as alive:
            return modelled(recipe, shots, scaled, whole, alive)
    parts = [pictures_of(recipe, photos(only_parts(recipe, {number}))) for number in numbers]
    return {name: measured(p, [part[name] for part in parts]) for name, p in whole.items()}


def _warped(picture: Barred, homography: Homography) -> Barred:
    """Geometric correction: after all sums and differences, still linear and signed."""
    matrix = np.array(homography).reshape(3, 3)
    size_px = (picture.image.shape[1], picture.image.shape[0])
    # Where a saturated pixel or the world outside the picture has a share, nothing is known.
    known = np.isfinite(picture.sigma)
    whole = warp(known.astype(np.float64), matrix, size_px) > 1.0 - 1e-9

    def error(sigma: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(whole, warp(np.where(known, sigma, 0.0), matrix, size_px), np.inf)

    return Barred(
        image=warp(picture.image, matrix, size_px),
        sigma=error(picture.sigma),
        sensor=error(picture.sensor),
        code=error(picture.code),
        kind=picture.kind,
    )
