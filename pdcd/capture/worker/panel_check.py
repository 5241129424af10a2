"""Checks where both panels lie: takes photos of blocks, and evaluates them."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.capture.worker.answers import Order, PhotoOrder, PhotoOutcome, RigFacts, SpoiltPhoto
from pdcd.capture.worker.exposing import Exposer, Orders
from pdcd.panels.blocks import TOO_FEW, BlockPattern
from pdcd.pictures.misplaced import BlockPhotos, find_panel_places, quad_px
from pdcd.planning.metering import pick_aperture
from pdcd.planning.panel_look import (
    MASK_BLOCK_PHOTO,
    OFF_AXIS,
    PROJECTOR_BLOCK_PHOTO,
    WHITE_BLOCK_PHOTO,
    BlockFrames,
    count_block_rows,
    find_white_shot,
)
from pdcd.planning.plan import Plan
from pdcd.runs.record import MeterRecord, PanelLook, ShotRecord
from pdcd.sensor.raw import RawFrame

_CLIPPED = 0.02
"""Share of quads that may be clipped in a white photo, for highlights."""


@dataclass(frozen=True)
class _Exposure:
    """F-number of a photo, and refreshes for which it is shown."""

    f_number: float
    rows: int


class PanelCheck:
    """Takes the photos of a panel check, on the shelf of a job, and evaluates them."""

    def __init__(self, facts: RigFacts, exposer: Exposer, orders: Orders) -> None:
        self._facts, self._exposer, self._orders = facts, exposer, orders

    def run(
        self, plan: Plan, shots: tuple[ShotRecord, ...]
    ) -> Generator[Order, PhotoOutcome, PanelLook]:
        """Check the panels; the result says so where a photo was spoilt, or blocks would be too
        few.

        shots : those taken, including the white one if the plan has any.
        """
        config, shot = self._facts.config, find_white_shot(plan)
        if config.rig.arrangement == "off-axis":
            return _nobody_looked(OFF_AXIS)
        exposure = yield from self._exposure(plan)
        if shot is None:
            white, exposure = yield from self._take_white(exposure)
        else:
            record = next(one for one in shots if one.name == shot.name)
            white = self._read(record.raw, record.sha256)
        if isinstance(white, PanelLook):
            return white
        camera, size_px = make_camera_map(config, white.frame), config.projector.field_size_px
        blocks = BlockPattern.of((size_px, config.mask.size_px), quad_px(camera, size_px))
        if blocks is None:
            return _nobody_looked(TOO_FEW)
        photos = []
        for name in (PROJECTOR_BLOCK_PHOTO, MASK_BLOCK_PHOTO):
            photo = yield from self._take(name, blocks, exposure)
            if isinstance(photo, PanelLook):
                return photo
            photos.append(photo)
        projector, mask = photos
        seen = BlockPhotos(
            white=_light(white),
            projector=_light(projector),
            mask=_light(mask),
            known=~(white.saturated | projector.saturated | mask.saturated),
        )
        panels = panels_of(config)
        maps = (panels.projector.map, panels.mask.map)
        return find_panel_places(seen, blocks, camera, maps, size_px, config.mask.blur_px)

    def _exposure(self, plan: Plan) -> Generator[Order, PhotoOutcome, _Exposure]:
        """The exposure of the white shot; without one, that for which the codes were metered."""
        shot = find_white_shot(plan) or plan.last_exposed
        f_number = yield from self._exposer.aperture(shot, plan.recipe.shots, plan.sequence)
        return _Exposure(f_number, count_block_rows(plan))

    def _take_white(
        self, exposure: _Exposure
    ) -> Generator[Order, PhotoOutcome, tuple[RawFrame | PanelLook, _Exposure]]:
        """A white photo for a run without such a shot, and its exposure. Codes may have been
        metered without the direct light, so it is taken again with less light while too much is
        clipped."""
        while True:
            photo = yield from self._take(WHITE_BLOCK_PHOTO, BlockPattern(1, 1), exposure)
            if isinstance(photo, PanelLook) or photo.saturated.mean() < _CLIPPED:
                return photo, exposure
            dimmer = self._dimmed(exposure)
            if dimmer == exposure:
                return photo, exposure
            exposure = dimmer

    def _dimmed(self, exposure: _Exposure) -> _Exposure:
        """The exposure with a ninth of the light, by the aperture, or by the time where the
        aperture is fixed; the same where there is no less."""
        if self._facts.config.camera.f_number != "auto":
            return replace(exposure, rows=max(1, exposure.rows // 9))
        stops = self._exposer.camera.f_numbers
        return replace(exposure, f_number=pick_aperture(stops, 3.0 * exposure.f_number))

    def _take(
        self, name: str, blocks: BlockPattern, exposure: _Exposure
    ) -> Generator[Order, PhotoOutcome, RawFrame | PanelLook]:
        """Take one photo; returns a `PanelLook` that says why where it was spoilt."""
        frames = BlockFrames(self._facts.config, blocks, exposure.rows).frames(name)
        f_number = exposure.f_number
        settings = self._exposer.settings(f_number)
        taken = yield from self._orders.look(PhotoOrder("look", name, frames, settings, f_number))
        if isinstance(taken, SpoiltPhoto):
            return _nobody_looked(taken.message)
        yield self._orders.tell(MeterRecord(raw=taken.raw, f_number=f_number, peak=None))
        return self._read(*taken.planes[0])

    def _read(self, raw: str, sha256: str) -> RawFrame:
        saturation_dn = self._facts.profile.saturation_dn(self._exposer.iso)
        return self._exposer.shelf.read(raw, sha256=sha256, saturation_dn=saturation_dn)


def _nobody_looked(why: str) -> PanelLook:
    return PanelLook(mask=None, camera=None, rest_px=0.0, direct=0.0, mask_seen=False, why=why)


def _light(frame: RawFrame) -> Floats:
    """Grey light of quads, (h, w)."""
    return np.asarray(frame.planes.mean(axis=0), dtype=np.float64)
