"""Where projector, mask and camera lie on one field: marks of both panels, on a card or a scene."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import camera_map, panels_of
from pdcd.bench.tables import Config
from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.geometry.compose import Composed, OneField, compose, one_field
from pdcd.calibration.geometry.dots import DotGrid, PanelName
from pdcd.calibration.geometry.finding import Dots, find_dots
from pdcd.calibration.geometry.fit import Fitted
from pdcd.calibration.geometry.lit import GREEN
from pdcd.calibration.geometry.panel_map import (
    believed_map,
    check_believed,
    check_seen,
    convergence,
    figures,
    fit_dots,
    quads_per_px,
    turned_against,
)
from pdcd.calibration.geometry.phase import PhaseCode
from pdcd.calibration.geometry.shared_field import ENOUGH, SharedField, edge_px, shared_field
from pdcd.calibration.geometry.striped import base_px, by_maps, by_xor
from pdcd.calibration.geometry.xor import XorCode
from pdcd.calibration.photo import Photo
from pdcd.calibration.preview import draw_arrows
from pdcd.calibration.registration.stripes import slope_at
from pdcd.calibration.script import (
    FIELD,
    Ask,
    Measured,
    Outcome,
    Script,
    Session,
    Taken,
    Wanted,
    take,
)
from pdcd.errors import CalibrationError, ConfigError
from pdcd.panels.map import Map, between
from pdcd.panels.map_soundness import LEAST_SHARE, on_device
from pdcd.words import MarksName

Floats = NDArray[np.float64]

LEAST_RADIUS_QUADS = 1.2
"""Radius of a dot in a photo below which its centre is not found."""
BLUR_SIGMA = 0.06
"""By how much the blur of edges of dots of 1.6 quads and more is found too small, at most."""
FINER = (
    "the maps are not sure where there are no dots, as at the edge of a photo that sees a part of "
    "a panel: let the camera see all of it, or take stripes, which go up to the edge: --marks xor"
)
PLACES = 32
"""Places of the mask along either axis at which its map's error is asked for."""
ALIKE_DEG = 20.0
"""Turns of both panels that differ by less are one turn of the camera."""


@dataclass(frozen=True, eq=False)
class Marked:
    """A panel's maps in red, green and blue, and its dots in green, if it showed dots."""

    panel: PanelName
    fitted: Sequence[Fitted]
    dots: Dots | None = None

    @property
    def green(self) -> Fitted:
        """The map that cells go by."""
        return self.fitted[GREEN]

    def check(self, session: Session, other: DotGrid, beside: Fitted | None = None) -> None:
        """Raise CalibrationError where its dots are not all to be seen: see `check_seen`."""
        if self.dots is not None:
            check_seen(self.green, self.dots, other=other, beside=beside, subject=session.subject)


def geometry(session: Session) -> Script:
    """White, black and dots of each panel on a card: six photos. On a scene dots of the mask, which
    hangs before it, and stripes of the projector: eight by the maps in use, XOR codes without any.

    The maps that come out replace the places of all three devices, and codes fill from then on what
    of the projector's picture these share.
    """
    projector, mask = yield from _marked(session)
    composed = compose(projector.green, mask.green)
    _refuse_unlike(session, composed)
    field = one_field(composed)
    maps = {"projector": field.projector, "mask": field.mask, "camera": field.camera}
    scale = finer(field.mask, field.projector)
    common = _shared(session, composed, field, scale)
    words = {f"{name}.place.map": Measured("maps.npz") for name in maps}
    words["mask.offset_px"] = Measured((0.0, 0.0))
    words[FIELD] = Measured(common.box)
    if mask.dots is not None:
        words["camera.blur_quads"] = Measured(_lens_blur_quads(mask.dots))
    told = [
        _field_figure(common),
        *figures(projector.green, "projector", 1.0, session.subject, mask.green),
        *figures(mask.green, "mask", scale, session.subject, projector.green),
        *convergence(projector.fitted, "projector", mask.fitted)[1],
    ]
    unsure = [f.name for f in told if f.name.endswith("map_px") and f.verdict is not Verdict.GOOD]
    return Outcome(
        figures=tuple(told),
        advice=(*common.advice, *([FINER] if unsure and session.subject == "card" else [])),
        picture=lambda figure: _draw(figure, projector, mask),
        words=words,
        maps=maps,
    )


def _shared(session: Session, composed: Composed, field: OneField, finer_px: float) -> SharedField:
    """The part of the projector's picture that mask and camera share."""
    mask, camera = field.mask, field.camera
    at = np.stack(np.meshgrid(*((np.arange(PLACES) + 0.5) / PLACES,) * 2), axis=-1)
    on_mask = at.reshape(-1, 2) * mask.size_px
    # Where nobody has seen the mask its map only goes on, and no field lies there.
    seen = on_device(field.projector, between(mask, field.projector, on_mask))
    seen &= on_device(camera, between(mask, camera, on_mask))
    sigma_px = float(np.nanquantile(composed.sigma_px(on_mask[seen]), 0.95)) if seen.any() else 0.0
    quads = quads_per_px(composed.projector_of)
    return shared_field(
        field.projector.size_px,
        {"mask": mask, "camera": camera},
        {"mask": edge_px(sigma_px, finer_px), "camera": edge_px(sigma_px, quads)},
        _cells(session.config),
    )


def _cells(config: Config) -> tuple[int, int] | None:
    """Rows and columns of code cells; None where they follow from the field, or from a file."""
    of_file = config.schedule.grid is None and config.scene.grid is None
    if config.schedule.grid == "auto" or (of_file and config.scene.kind == "matrix"):
        return None
    return config.code_grid()


def _lens_blur_quads(mask: Dots) -> float:
    """Standard deviation of the camera's own blur, by the edges of the mask's dots, which it alone
    blurs: without the width of the quads; 0 where that is all there is."""
    quad = 1.0 / np.sqrt(12.0)
    if mask.blur_quads < (1.0 + BLUR_SIGMA) * quad:
        return 0.0
    return float(np.sqrt(mask.blur_quads**2 - quad**2))


def _field_figure(common: SharedField) -> Figure:
    """How much of the projector's picture all three share."""
    verdict = (
        Verdict.GOOD if common.share >= ENOUGH
        else Verdict.DOUBTFUL if common.share >= LEAST_SHARE else Verdict.BAD
    )  # fmt: skip
    return Figure("geometry.field", common.share, 0.0, "", f"{ENOUGH:g} or more", verdict)


def _marked(session: Session) -> Generator[Wanted | Ask, Taken | None, tuple[Marked, Marked]]:
    """Both panels by what the session's marks are."""
    marks, (of_projector, of_mask) = marks_of(session), grids(session)
    if marks == "dots":
        projector = yield from _by_dots(session, of_projector, of_mask)
        mask = yield from _by_dots(session, of_mask, of_projector)
        projector.check(session, of_mask, mask.green)
        mask.check(session, of_projector, projector.green)
    else:  # the mask first: it is sharp whatever the scene is, and says where the projector may be
        mask = yield from _by_dots(session, of_mask, of_projector)
        mask.check(session, of_projector)
        near = yield from _beliefs(session, of_projector, mask.green, marks)
        projector = yield from _by_stripes(session, of_projector, near)
        if session.subject == "card":  # stripes go up to the photo's edge; dots do not
            near = [mask.green.to_target(_quads(mask.green))]
            mask = yield from _by_stripes(session, of_mask, near)
    return projector, mask


def marks_of(session: Session) -> MarksName:
    """What the panels are to show. Raises CalibrationError where maps are needed, and there are
    none."""
    if session.marks == "phase":
        for device in ("projector", "mask", "camera"):
            session.found(device)
    if session.marks != "auto":
        return session.marks
    if session.subject == "card":
        return "dots"
    try:
        return marks_of(replace(session, marks="phase"))
    except CalibrationError:
        return "xor"


def _by_stripes(
    session: Session, grid: DotGrid, near_px: Sequence[Floats]
) -> Generator[Wanted | Ask, Taken | None, Marked]:
    """A panel by stripes. near_px : beliefs that number their periods, (h, w, 2) pixels each."""
    code = _code(grid)
    striped = yield from by_maps(session, code, near_px)
    return Marked(grid.panel, striped.fitted(session, code))


def _beliefs(
    session: Session, grid: DotGrid, mask_of: Fitted, marks: MarksName
) -> Generator[Wanted | Ask, Taken | None, list[Floats]]:
    """Pixels of the projector that quads may see, (h, w, 2) each: by XOR codes, or by the maps in
    use.

    mask_of : from quads to the mask, as it was found just now.
    """
    quads = _quads(mask_of)
    if marks == "xor":
        believed = panels_of(session.config)
        fine = finer(believed.mask.map, believed.projector.map)
        base = base_px(quads_per_px(mask_of) * fine)
        rough = yield from by_xor(session, XorCode(grid.panel, grid.size_px, base))
        return [rough.to_target(quads)]
    camera, projector, mask = (session.found(d) for d in ("camera", "projector", "mask"))
    # Where the camera was bumped, mask and projector still lie as they did to each other.
    near = [between(mask, projector, mask_of.to_target(quads))]
    if camera.size_px == mask_of.map.size_px:
        near.append(between(camera, projector, quads))
    return near


def _quads(found: Fitted) -> Floats:
    """Centres of all quads of a photo, (h, w, 2)."""
    width, height = found.map.size_px
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def _code(grid: DotGrid) -> PhaseCode:
    """Stripes as wide as the dots of a panel."""
    return PhaseCode(grid.panel, grid.size_px, period_px=2 * (grid.pitch_px // 4))


def finer(mask: Map, projector: Map) -> float:
    """Pixels of the mask to one of the projector, along a side, in the middle of the mask."""
    middle = 0.5 * np.array([mask.size_px], dtype=np.float64)
    slopes = [slope_at(axis, projector, mask, middle)[0] for axis in (0, 1)]
    return float(1.0 / np.sqrt(abs(np.linalg.det(np.array(slopes)))))


def grids(session: Session) -> tuple[DotGrid, DotGrid]:
    """The dots of projector and mask."""
    projector, mask = session.sizes
    return DotGrid.usual("projector", projector), DotGrid.usual("mask", mask)


def _by_dots(
    session: Session, grid: DotGrid, other: DotGrid
) -> Generator[Wanted | Ask, Taken | None, Marked]:
    """A panel by the photos of its three pictures, seen where the other one lets light pass.

    other : dots of the other panel, to tell swapped outputs.
    """
    photos: list[Photo] = []
    pattern, subject = "RGGB", session.subject
    for shown in grid.shown(session.full):
        taken = yield from take(Wanted(shown))
        photos.append(session.photo(taken))
        _refuse_coarse(photos[0].frame, grid)
        pattern = taken.raw.pattern
    dots = find_dots(
        photos[0], photos[1], photos[2], grid, other=other, pattern=pattern, subject=subject
    )
    fitted = [fit_dots(one, photos[0].frame, subject) for one in dots]
    return Marked(grid.panel, fitted, dots[GREEN])


def _refuse_coarse(frame: tuple[int, int], grid: DotGrid) -> None:
    """Raise CalibrationError where quads are so large that a dot has hardly any, even if the panel
    fills the photo."""
    across = max(frame[0] / grid.size_px[1], frame[1] / grid.size_px[0])
    if across * grid.radius_px < LEAST_RADIUS_QUADS:
        raise CalibrationError(
            f"a photo of {frame[1]} x {frame[0]} quads is too coarse for the {grid.panel}'s dots",
            device="camera",
            hint="set the camera to full-size RAW; of a mock bench, set camera.frame_quads",
        )


def _refuse_unlike(session: Session, composed: Composed) -> None:
    """Raise CalibrationError for a panel that is mirrored or turned unlike the configuration, where
    the other one is not: what both show alike is the camera's own way of looking."""
    found = composed.projector_of.map, composed.mask_of.map
    width, height = found[0].size_px
    try:
        panels = panels_of(session.config)
        camera = camera_map(session.config, (height, width))
    except ConfigError:
        return  # a belief that cannot be tells nothing
    believed = [believed_map(camera, one.map) for one in (panels.projector, panels.mask)]
    turns = [turned_against(*both) for both in zip(found, believed, strict=True)]
    apart = abs((turns[0][0] - turns[1][0] + 180.0) % 360.0 - 180.0)
    if turns[0][1] == turns[1][1] and apart < ALIKE_DEG:
        return
    for number, panel in enumerate(("projector", "mask")):
        check_believed(found[number], believed[number], panel, believed[1 - number])


def _draw(figure: Any, *panels: Marked) -> None:
    """What the maps of projector and mask leave of each mark."""
    for axes, marked in zip(figure.subplots(1, 2), panels, strict=True):
        fitted = marked.green
        size = np.array(fitted.target_size_px, dtype=np.float64)
        what = "blocks of stripes" if marked.dots is None else "dots"
        title = f"{marked.panel}: what the map leaves of {len(fitted.target_px)} {what}"
        draw_arrows(axes, fitted.target_px / size, fitted.residual_px, title)
