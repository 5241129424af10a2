"""Where projector, mask and camera lie on one field, by marks of both panels on a card or a
scene."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.tables import Config
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.geometry.compose import ComposedMaps, compose_maps
from pdcd.calibration.geometry.dots import DotGrid
from pdcd.calibration.geometry.finding import Dots, find_dots
from pdcd.calibration.geometry.fit import FittedMap
from pdcd.calibration.geometry.panel_map import (
    check_dot_coverage,
    check_orientation,
    compare_orientation,
    fit_dots,
    list_map_figures,
    make_believed_map,
    measure_convergence,
    quads_per_px,
)
from pdcd.calibration.geometry.phase import PhaseCode
from pdcd.calibration.geometry.shared_field import ENOUGH, SharedField, edge_px, find_shared_field
from pdcd.calibration.geometry.striped import base_px, measure_stripes, measure_xor_map
from pdcd.calibration.geometry.xor import XorCode
from pdcd.calibration.photo import SMALL_FRAME_HINT, QuadPhoto, pick_main
from pdcd.calibration.preview import ArrowField, draw_arrows
from pdcd.calibration.registration.stripes import compute_map_slope
from pdcd.calibration.script import (
    FIELD,
    CalibrationPhoto,
    CalibrationSession,
    ConfigValue,
    PhotoRequest,
    StepOutcome,
    StepScript,
    UserPrompt,
    take_photo,
)
from pdcd.calibration.shown import PanelName
from pdcd.errors import CalibrationError, ConfigError
from pdcd.panels.map import Map, map_between
from pdcd.panels.map_soundness import LEAST_SHARE, find_points_on_device
from pdcd.words import MarksName

_LEAST_RADIUS_QUADS = 1.2
"""Radius of a dot in a photo below which its centre cannot be measured."""
_BLUR_SIGMA = 0.06
"""By how much the blur of the edges of dots of 1.6 quads or more is underestimated, at most."""
_FINER = (
    "the maps are not sure where there are no dots, as at the edge of a photo that sees a part of "
    "a panel: let the camera see all of it, or take stripes, which go up to the edge: --marks xor"
)
_PLACES = 32
"""Places of the mask along either axis at which its map's error is computed."""
_ALIKE_DEG = 20.0
"""Where the turns of both panels differ by less than this, the camera alone is turned."""


@dataclass(frozen=True, eq=False)
class PanelMarks:
    """A panel's maps in each colour of the camera, and its dots in the main one, if it showed
    dots."""

    panel: PanelName
    fitted: Sequence[FittedMap]
    dots: Dots | None = None

    @property
    def main(self) -> FittedMap:
        """The map that cells go by."""
        return pick_main(self.fitted)

    def check(
        self, session: CalibrationSession, other: DotGrid, beside: FittedMap | None = None
    ) -> None:
        """Raise CalibrationError where dots cannot be seen: see `check_dot_coverage`."""
        if self.dots is not None:
            check_dot_coverage(
                self.main, self.dots, other=other, beside=beside, subject=session.subject
            )


def calibrate_geometry(session: CalibrationSession) -> StepScript:
    """White, black and dots of each panel on a card: six photos. On a scene, dots of the mask,
    which hangs in front of it, and stripes of the projector: eight photos where maps are in use,
    XOR codes where there are none.

    The resulting maps replace the places of all three devices. From then on codes fill what these
    share of the projector's picture.
    """
    projector, mask = yield from _marked(session)
    composed = compose_maps(projector.main, mask.main)
    _refuse_unlike(session, composed)
    maps = composed.maps
    scale = compute_pixel_ratio(maps["mask"], maps["projector"])
    common = _shared(session, composed, scale)
    words = {f"{name}.place.map": ConfigValue("maps.npz") for name in maps}
    words["mask.offset_px"] = ConfigValue((0.0, 0.0))
    words[FIELD] = ConfigValue(common.box)
    if mask.dots is not None:
        words["camera.blur_quads"] = ConfigValue(_lens_blur_quads(mask.dots))
    told = [
        _field_figure(common),
        *list_map_figures(projector.main, "projector", 1.0, session.subject, mask.main),
        *list_map_figures(mask.main, "mask", scale, session.subject, projector.main),
        *measure_convergence(projector.fitted, "projector", mask.fitted)[1],
    ]
    unsure = [f.name for f in told if f.name.endswith("map_px") and f.verdict is not Verdict.GOOD]
    return StepOutcome(
        figures=tuple(told),
        advice=(*common.advice, *([_FINER] if unsure and session.subject == "card" else [])),
        picture=lambda figure: _draw(figure, projector, mask),
        words=words,
        maps=maps,
    )


def _shared(session: CalibrationSession, composed: ComposedMaps, finer_px: float) -> SharedField:
    """The part of the projector's picture that mask and camera share."""
    projector, mask, camera = composed.maps.values()
    at = np.stack(np.meshgrid(*((np.arange(_PLACES) + 0.5) / _PLACES,) * 2), axis=-1)
    on_mask = at.reshape(-1, 2) * mask.size_px
    # Where the camera does not see the mask, its map is only extrapolated: no field lies there.
    seen = find_points_on_device(projector, map_between(mask, projector, on_mask))
    seen &= find_points_on_device(camera, map_between(mask, camera, on_mask))
    sigma_px = float(np.nanquantile(composed.sigma_px(on_mask[seen]), 0.95)) if seen.any() else 0.0
    quads = quads_per_px(composed.projector_of)
    return find_shared_field(
        projector.size_px,
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
    """Standard deviation of the camera's own blur, without the width of the quads. It is measured
    at the edges of the mask's dots, which only the camera blurs; 0 where these are as sharp as the
    quads."""
    quad = 1.0 / np.sqrt(12.0)
    if mask.blur_quads < (1.0 + _BLUR_SIGMA) * quad:
        return 0.0
    return float(np.sqrt(mask.blur_quads**2 - quad**2))


def _field_figure(common: SharedField) -> MeasuredFigure:
    """How much of the projector's picture all three share."""
    verdict = (
        Verdict.GOOD if common.share >= ENOUGH
        else Verdict.DOUBTFUL if common.share >= LEAST_SHARE else Verdict.BAD
    )  # fmt: skip
    return MeasuredFigure("geometry.field", common.share, 0.0, "", f"{ENOUGH:g} or more", verdict)


def _marked(
    session: CalibrationSession,
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, tuple[PanelMarks, PanelMarks]]:
    """Measure both panels with the session's marks."""
    marks, (of_projector, of_mask) = choose_marks(session), make_dot_grids(session)
    if marks == "dots":
        projector = yield from _by_dots(session, of_projector, of_mask)
        mask = yield from _by_dots(session, of_mask, of_projector)
        projector.check(session, of_mask, mask.main)
        mask.check(session, of_projector, projector.main)
    else:  # the mask first: it is sharp whatever the scene is, and says where the projector may be
        mask = yield from _by_dots(session, of_mask, of_projector)
        mask.check(session, of_projector)
        near = yield from _beliefs(session, of_projector, mask.main, marks)
        projector = yield from _by_stripes(session, of_projector, near)
        if session.subject == "card":  # stripes go up to the photo's edge; dots do not
            near = [mask.main.to_target(_quads(mask.main))]
            mask = yield from _by_stripes(session, of_mask, near)
    return projector, mask


def choose_marks(session: CalibrationSession) -> MarksName:
    """Which marks the panels show. Raises CalibrationError where maps are needed, and there are
    none."""
    if session.marks == "phase":
        for device in ("projector", "mask", "camera"):
            session.found(device)
    if session.marks != "auto":
        return session.marks
    if session.subject == "card":
        return "dots"
    try:
        return choose_marks(replace(session, marks="phase"))
    except CalibrationError:
        return "xor"


def _by_stripes(
    session: CalibrationSession, grid: DotGrid, near_px: Sequence[Floats]
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, PanelMarks]:
    """Measure a panel with stripes. near_px : pixels that quads are believed to see, (h, w, 2)
    each; periods are numbered by the best of them."""
    code = _code(grid)
    return PanelMarks(grid.panel, (yield from measure_stripes(session, code, near_px)))


def _beliefs(
    session: CalibrationSession, grid: DotGrid, mask_of: FittedMap, marks: MarksName
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, list[Floats]]:
    """Pixels of the projector that quads are believed to see, (h, w, 2) each: by XOR codes, or by
    the maps in use.

    mask_of : from quads to the mask, as just measured.
    """
    quads = _quads(mask_of)
    if marks == "xor":
        believed = panels_of(session.config)
        fine = compute_pixel_ratio(believed.mask.map, believed.projector.map)
        base = base_px(quads_per_px(mask_of) * fine)
        rough = yield from measure_xor_map(session, XorCode(grid.panel, grid.size_px, base))
        return [rough.to_target(quads)]
    camera, projector, mask = (session.found(d) for d in ("camera", "projector", "mask"))
    # If the camera was bumped, mask and projector still lie as before relative to each other.
    near = [map_between(mask, projector, mask_of.to_target(quads))]
    if camera.size_px == mask_of.map.size_px:
        near.append(map_between(camera, projector, quads))
    return near


def _quads(found: FittedMap) -> Floats:
    """Centres of all quads of a photo, (h, w, 2)."""
    width, height = found.map.size_px
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def _code(grid: DotGrid) -> PhaseCode:
    """Stripes as wide as the dots of a panel."""
    return PhaseCode(grid.panel, grid.size_px, period_px=2 * (grid.pitch_px // 4))


def compute_pixel_ratio(mask: Map, projector: Map) -> float:
    """Pixels of the mask per pixel of the projector, along a side, in the middle of the mask."""
    middle = 0.5 * np.array([mask.size_px], dtype=np.float64)
    slopes = [compute_map_slope(axis, projector, mask, middle)[0] for axis in (0, 1)]
    return float(1.0 / np.sqrt(abs(np.linalg.det(np.array(slopes)))))


def make_dot_grids(session: CalibrationSession) -> tuple[DotGrid, DotGrid]:
    """The dots of projector and mask."""
    projector, mask = session.sizes
    return DotGrid.usual("projector", projector), DotGrid.usual("mask", mask)


def _by_dots(
    session: CalibrationSession, grid: DotGrid, other: DotGrid
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, PanelMarks]:
    """Measure a panel with photos of its three pictures, seen where the other panel lets light
    pass.

    other : dots of the other panel, by which swapped outputs are recognised.
    """
    photos: list[QuadPhoto] = []
    pattern, subject = "RGGB", session.subject
    for shown in grid.shown(session.full):
        taken = yield from take_photo(PhotoRequest(shown))
        photos.append(session.photo(taken))
        _refuse_coarse(photos[0].frame, grid)
        pattern = taken.raw.pattern
    dots = find_dots(
        photos[0], photos[1], photos[2], grid, other=other, pattern=pattern, subject=subject
    )
    fitted = [fit_dots(one, photos[0].frame, subject) for one in dots]
    return PanelMarks(grid.panel, fitted, pick_main(dots))


def check_dots_in_frame(session: CalibrationSession, frame: tuple[int, int]) -> None:
    """Raise CalibrationError where photos of that size are too coarse for the dots to be shown."""
    of_projector, of_mask = make_dot_grids(session)
    _refuse_coarse(frame, of_mask)
    if choose_marks(session) == "dots":
        _refuse_coarse(frame, of_projector)


def _refuse_coarse(frame: tuple[int, int], grid: DotGrid) -> None:
    """Raise CalibrationError where quads are so large that a dot covers hardly any, even if the
    panel fills the photo."""
    across = max(frame[0] / grid.size_px[1], frame[1] / grid.size_px[0])
    if across * grid.radius_px < _LEAST_RADIUS_QUADS:
        raise CalibrationError(
            f"a photo of {frame[1]} x {frame[0]} pixels is too coarse for the {grid.panel}'s dots",
            device="camera",
            hint=SMALL_FRAME_HINT,
        )


def _refuse_unlike(session: CalibrationSession, composed: ComposedMaps) -> None:
    """Raise CalibrationError where one panel is mirrored or turned, unlike the configuration, and
    the other one is not. What both have in common is how the camera is turned."""
    found = composed.projector_of.map, composed.mask_of.map
    width, height = found[0].size_px
    try:
        panels = panels_of(session.config)
        camera = make_camera_map(session.config, (height, width))
    except ConfigError:
        return  # an impossible configuration is nothing to compare with
    believed = [make_believed_map(camera, one.map) for one in (panels.projector, panels.mask)]
    turns = [compare_orientation(*both) for both in zip(found, believed, strict=True)]
    apart = abs((turns[0][0] - turns[1][0] + 180.0) % 360.0 - 180.0)
    if turns[0][1] == turns[1][1] and apart < _ALIKE_DEG:
        return
    for number, panel in enumerate(("projector", "mask")):
        check_orientation(found[number], believed[number], panel, believed[1 - number])


def _draw(figure: Any, *panels: PanelMarks) -> None:
    """Residuals of the maps of projector and mask at each mark."""
    fields = []
    for marked in panels:
        fitted = marked.main
        size = np.array(fitted.target_size_px, dtype=np.float64)
        what = "blocks of stripes" if marked.dots is None else "dots"
        title = f"{marked.panel}: what the map leaves of {len(fitted.target_px)} {what}"
        fields.append(ArrowField(fitted.target_px / size, fitted.residual_px, title))
    draw_arrows(figure, fields)
