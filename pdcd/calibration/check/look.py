"""A look at the bench: the photos of a check, what they say, and how that is kept.

The same photos are taken right after a calibration, as the reference, and before a session.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.check.changes import Dots, Look, closed_share, matched, parts_of
from pdcd.calibration.check.similarity import Similarity, similarity
from pdcd.calibration.geometry.dots import DotGrid
from pdcd.calibration.geometry.finding import find_again
from pdcd.calibration.geometry.geometry_step import grids
from pdcd.calibration.photo import Photo
from pdcd.calibration.registration.correction import bent_to, nodes_of
from pdcd.calibration.script import Ask, Session, Taken, Wanted, take
from pdcd.calibration.shown import still
from pdcd.calibration.timing.delayed import ran_as
from pdcd.calibration.timing.programmes import (
    BLACKS,
    PULSES,
    WHITES,
    Programme,
    strip_photo,
    strips_on,
)
from pdcd.calibration.timing.strips import read_strips
from pdcd.calibration.timing.timing_model import Model, Tail, Times
from pdcd.calibration.window import shared
from pdcd.panels.frames import BLACK, WHITE
from pdcd.panels.map import Map, between

Floats = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]
Photos = Generator[Wanted | Ask, Taken | None, "Seen"]

GREEN = 1
PROGRAMMES: tuple[Programme, ...] = (*PULSES, WHITES, BLACKS)
"""Of the strips."""
STRIPS_FLOOR = 1e-4
"""Error of a strip over white, besides noise: edges, and light from beside."""
DOTS_END = 1.75
"""Radii from the middle of a dot at which its light has ended; dots are five radii apart."""
PANELS = ("projector", "mask")


@dataclass(frozen=True)
class Exposure:
    """How a look is taken; f_number None where the lens is not set from here."""

    iso: int
    f_number: float | None
    refreshes: int


@dataclass(frozen=True, eq=False)
class Seen:
    """A look, with what its strips say; None without a measured timing."""

    look: Look
    strips: Strips | None = None


@dataclass(frozen=True, eq=False)
class Strips:
    """value, sigma : (B * K,) light of the strips over white, of every band. model : from a change
    of the lag in s to the same, by the timing that was measured."""

    value: Floats
    sigma: Floats
    model: Lagged


@dataclass(frozen=True, eq=False)
class Lagged:
    """What strips should look like, by how much later the mask is than it was measured."""

    model: Model
    times: Times

    def __call__(self, later_s: float) -> Floats:
        """(B * K,), light over white."""
        late = replace(self.times, lags_s=self.times.lags_s + later_s)
        return np.asarray(self.model.shape(late)[0].ravel())

    def leaking(self, more: float) -> Lagged:
        """The same with more light through the mask's black, over white."""
        a, b = self.times.leaks.tolist()
        return replace(self, times=replace(self.times, leaks=np.array([a, max(b + more, 0.0)])))


def look(session: Session, exposure: Exposure, expected: Mapping[str, Dots]) -> Photos:
    """Four photos, and one of strips where the timing was measured.

    expected : dots of either panel where they should be.
    """
    camera = session.found("camera")
    refreshes = exposure.refreshes
    shown = session.in_step(still("white", refreshes, WHITE, WHITE))
    taken = yield from _photo(exposure, shown)
    white, said = session.photo(taken), taken.seen
    shown = session.in_step(still("room", refreshes, BLACK, WHITE))
    room = session.photo((yield from _photo(exposure, shown)))
    found: dict[str, Dots] = {}
    closed = (0.0, 0.0)
    for panel, grid in zip(PANELS, grids(session), strict=True):
        picture = grid.dots()
        sides = (picture, WHITE) if panel == "projector" else (WHITE, picture)
        shown = session.in_step(still(f"dots-{panel}", refreshes, *sides))
        taken = yield from _photo(exposure, shown)
        photo = session.photo(taken)
        before = expected[panel]
        found[panel] = Dots(*_again(white, photo, grid, before))
        if panel == "mask":
            radius = DOTS_END * grid.radius_px * _quads_per_px(session.found("mask"), camera)
            closed = closed_share(
                photo.light[..., GREEN], photo.variance[..., GREEN], white.light[..., GREEN],
                _all_places(session, before, found[panel]), radius,
            )  # fmt: skip
    settings = _settings(session, exposure, said.iso, said.f_number)
    open_s = refreshes * session.refresh_s
    light = parts_of(white.light[..., GREEN] - room.light[..., GREEN]) / open_s
    found_look = Look(
        found["projector"], found["mask"], light, closed, (0.0, 0.0), settings,
        white.saturated_share(white.light[..., GREEN] > 0.25 * float(np.max(light)) * open_s),
    )  # fmt: skip
    if "timing.lag_s" not in session.arrays:
        return Seen(found_look)
    camera = as_it_lies(camera, similarity(*matched(found["projector"], expected["projector"])))
    strips = yield from _strips(session, exposure, (white, room), camera)
    return Seen(found_look, strips)


def by_maps(session: Session) -> dict[str, Dots]:
    """Where dots should be, by the maps."""
    camera = session.found("camera")
    found = {}
    for panel, grid in zip(PANELS, grids(session), strict=True):
        rows, cols = grid.shape
        index = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).reshape(-1, 2)
        quads = between(session.found(panel), camera, grid.centres(index))
        with np.errstate(invalid="ignore"):
            inside = ((quads > 0.0) & (quads < camera.size_px)).all(axis=-1)
        found[panel] = Dots(index[inside], quads[inside], np.zeros(int(inside.sum())))
    return found


def as_it_lies(camera: Map, moved: Similarity) -> Map:
    """The camera's map after all of the photo has moved. Raises ConfigError where it cannot be."""
    return bent_to(camera, lambda at: camera.to_field(moved.back(at)), nodes_of(camera), "camera")


def _all_places(session: Session, before: Dots, now: Dots) -> Floats:
    """Where all dots of the mask are in the photo, (n, 2), those that were not found, too: their
    light is not what comes through black."""
    (_, grid), mask = grids(session), session.found("mask")
    rows, cols = grid.shape
    index = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).reshape(-1, 2)
    moved = similarity(*matched(now, before))
    places = moved(between(mask, session.found("camera"), grid.centres(index)))
    return np.asarray(places[np.isfinite(places).all(axis=-1)])


def kept(
    seen: Seen, exposure: Exposure, calibrated: Floats, later_s: float = 0.0
) -> dict[str, NDArray[Any]]:
    """A look as arrays.

    calibrated : `fingerprint` of what it belongs to. later_s : by which its lag is no longer the
        one of its model.
    """
    now = seen.look
    arrays: dict[str, NDArray[Any]] = {
        "check.white": now.white,
        "check.closed": np.array(now.closed),
        "check.settings": _text(now.settings),
        "check.exposure": np.array(
            [exposure.iso, exposure.f_number or 0.0, exposure.refreshes], dtype=np.float64
        ),
        "check.calibrated": calibrated,
        # Without strips: arrays that are kept must hold some numbers, and finite ones.
        "check.strips": np.zeros((2, 1)),
    }
    for panel in PANELS:
        dots: Dots = getattr(now, panel)
        arrays |= {
            f"check.{panel}.index": dots.index,
            f"check.{panel}.quads": dots.quads,
            f"check.{panel}.sigma": dots.sigma,
        }
    if (strips := seen.strips) is not None:
        # What the model says depends on the delay that the display takes out: kept is the rest.
        arrays["check.strips"] = np.stack([strips.value - strips.model(later_s), strips.sigma])
    return arrays


def reference(arrays: Arrays) -> tuple[Look, Exposure, Floats, Floats]:
    """A look that was kept, how it was taken, what its strips leave of the model with their sigma
    (2, B * K), and what it belongs to. Arrays that were kept in a file are float64, all of them.
    Raises KeyError where none was."""
    dots = {
        panel: Dots(
            arrays[f"check.{panel}.index"].astype(np.int64),
            arrays[f"check.{panel}.quads"],
            arrays[f"check.{panel}.sigma"],
        )
        for panel in PANELS
    }
    iso, f_number, refreshes = arrays["check.exposure"].tolist()
    closed, sigma = arrays["check.closed"].tolist()
    then = Look(
        dots["projector"], dots["mask"], arrays["check.white"], (closed, sigma), (0.0, 0.0),
        json.loads(arrays["check.settings"].astype(np.uint8).tobytes()),
    )  # fmt: skip
    exposure = Exposure(int(iso), f_number or None, int(refreshes))
    return then, exposure, arrays["check.strips"], arrays["check.calibrated"]


def fingerprint(session: Session) -> Floats:
    """What a reference belongs to, as numbers: maps, lags, contrast, and what was calibrated of the
    camera. Another calibration of any of these asks for another reference."""
    config = session.config
    parts: list[Any] = []
    for device in (*PANELS, "camera"):
        map_: Map = session.found(device)
        parts += [map_.homography, map_.radial, np.ravel(map_.residual)]
    parts += [
        session.arrays.get("timing.lag_s", ()),
        session.arrays.get("timing.taus_s", ()),
        (config.mask.contrast or 0.0, config.projector.contrast or 0.0),
        config.camera.responsivity_e or (),
    ]
    return np.concatenate([np.asarray(part, dtype=np.float64).ravel() for part in parts])


def _photo(exposure: Exposure, shown: Any) -> Generator[Wanted | Ask, Taken | None, Taken]:
    return (yield from take(Wanted(shown, exposure.iso, exposure.f_number)))


def _again(
    white: Photo, photo: Photo, grid: DotGrid, before: Dots
) -> tuple[NDArray[np.int64], Floats, Floats]:
    index, quads, sigma = find_again(white, photo, grid, before.index, before.quads)
    return index, quads, np.hypot(*sigma.T) / np.sqrt(2.0)


def _strips(
    session: Session, exposure: Exposure, white_and_room: tuple[Photo, Photo], camera: Map
) -> Generator[Wanted | Ask, Taken | None, Strips]:
    """What strips say, and the model of it."""
    projector, mask = session.found("projector"), session.found("mask")
    lags = session.arrays["timing.lag_s"]
    strips = strips_on(projector, 0, PROGRAMMES, shared(mask, camera))
    period = strips.programmes[0].of
    periods = exposure.refreshes // period
    shown = strip_photo("strips", strips, projector, mask, white=False, periods=periods)
    taken = yield from _photo(exposure, session.in_step(shown))
    ran = ran_as(taken.ran, session.behind_rows, shown.refreshes)
    (white, room), photo = white_and_room, session.photo(taken)
    read = read_strips(photo, white, camera, strips, bands=lags.size, gaps=False, room=room)
    share = exposure.refreshes / (periods * period)
    value, sigma = share * read.value, np.hypot(share * read.sigma, STRIPS_FLOOR)
    on_mask, tail_share, slower = session.arrays.get("timing.tail", np.array([0.0, 0.0, 1.0]))
    tail = Tail(bool(on_mask), float(tail_share), float(slower)) if tail_share else None
    across_s = float(session.arrays.get("timing.across_s", 0.0))
    taus_s, leaks = session.arrays["timing.taus_s"], session.arrays["timing.leaks"]
    times = Times(taus_s, leaks, lags, tail, across_s)
    model = Model([read], [ran], session.refresh_s)
    model.slope_s = float(np.polyfit(read.bands, lags, 1)[0]) if lags.size > 1 else 0.0
    return Strips(value.ravel(), sigma.ravel(), Lagged(model, times))


def _settings(
    session: Session, exposure: Exposure, told_iso: int, told_f: float | None
) -> dict[str, str]:
    """What must not change from a calibration to a session."""
    camera, fixed = session.camera, session.config.camera.f_number
    f_number = exposure.f_number if fixed == "auto" else fixed
    width, height = session.found("camera").size_px
    return {
        "camera": f"{camera.model} {camera.serial}".strip(),
        "iso": str(session.iso),
        "iso by the file": str(told_iso or exposure.iso),
        "f_number": f"{f_number or 0.0:g}",
        "f_number by the file": f"{told_f or 0.0:.3g}",
        "frame": f"{width} x {height} quads",
    }


def _quads_per_px(panel: Map, camera: Map) -> float:
    """Quads of the photo to a pixel of the panel, in its middle."""
    middle = 0.5 * np.array([panel.size_px], dtype=np.float64)
    ends = [between(panel, camera, middle + step) for step in ((-0.5, 0.0), (0.5, 0.0))]
    return float(np.hypot(*(ends[1] - ends[0])[0]))


def _text(words: Mapping[str, str]) -> NDArray[np.uint8]:
    """Words as bytes: arrays that are kept hold numbers only."""
    return np.frombuffer(json.dumps(words, sort_keys=True).encode(), dtype=np.uint8)
