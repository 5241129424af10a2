"""The look at both panels on its way: photos of blocks, and what they say of the panels."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import camera_map, panels_of
from pdcd.capture.worker.answers import Facts, Order, Photo, Spoilt, Taken, Wanted
from pdcd.capture.worker.exposing import Exposer, Orders
from pdcd.errors import PdcdError
from pdcd.panels.blocks import TOO_FEW, Blocks
from pdcd.pictures.misplaced import BlockPhotos, panel_look, quad_px
from pdcd.planning.panel_look import LOOKS, MASK, PROJECTOR, WHITE, BlockFrames, rows_of, white_shot
from pdcd.planning.plan import Plan
from pdcd.runs.record import MeterRecord, PanelLook, ShotRecord
from pdcd.sensor.raw import RawFrame, read_raw

Floats = NDArray[np.float64]


class PanelCheck:
    """Takes the photos of a look, in the run folder of a job, and works out what they say."""

    def __init__(self, facts: Facts, folder: Path, exposer: Exposer, orders: Orders) -> None:
        self._facts, self._folder = facts, folder
        self._exposer, self._orders = exposer, orders

    def run(self, plan: Plan, shots: tuple[ShotRecord, ...]) -> Generator[Order, Taken, PanelLook]:
        """Look at the panels; where a photo was spoilt, or blocks would be too few, says so.

        shots : that were taken, the white one among them if the plan has any.
        """
        config, white = self._facts.config, white_shot(plan)
        sizes = config.projector.size_px, config.mask.size_px
        names: tuple[str, ...] = LOOKS
        files: dict[str, tuple[str, str]] = {}
        if white is not None:
            record = next(shot for shot in shots if shot.name == white.name)
            files, names = {WHITE: (record.raw, record.sha256)}, LOOKS[1:]
        blocks = self._blocks(files, sizes)
        for name in names:
            if blocks is None:
                if WHITE in files:
                    return _nobody_looked(TOO_FEW)
                blocks = Blocks(1, 1)  # white shows none
            due = BlockFrames(config, blocks, rows_of(plan))
            taken = yield from self._take(plan, name, due)
            if isinstance(taken, PanelLook):
                return taken
            files[name] = taken
            if name == WHITE:
                blocks = self._blocks(files, sizes)
        if blocks is None:
            return _nobody_looked(TOO_FEW)
        return self._said(files, blocks)

    def _blocks(
        self, files: dict[str, tuple[str, str]], sizes: tuple[tuple[int, int], ...]
    ) -> Blocks | None:
        """Blocks that the camera can see by its photo of all light, and None before that."""
        if WHITE not in files:
            return None
        frame = self._read(files[WHITE]).frame
        camera = camera_map(self._facts.config, frame)
        return Blocks.of(sizes, quad_px(camera, sizes[0]))

    def _take(
        self, plan: Plan, name: str, due: BlockFrames
    ) -> Generator[Order, Taken, tuple[str, str] | PanelLook]:
        """Take one photo at the aperture of the white shot; where it was spoilt, says so."""
        shot = white_shot(plan) or plan.last_exposed
        f_number = yield from self._exposer.aperture(shot, plan.recipe.shots, plan.sequence)
        settings = self._exposer.settings(f_number)
        taken = yield from self._orders.expose(
            Wanted("look", name, due.frames(name), settings, f_number)
        )
        if isinstance(taken, Spoilt):
            return _nobody_looked(taken.message)
        if not isinstance(taken, Photo):
            raise PdcdError("a photo of blocks came as none")
        yield self._orders.tell(MeterRecord(raw=taken.raw, f_number=f_number, peak=None))
        return taken.planes[0]

    def _said(self, files: dict[str, tuple[str, str]], blocks: Blocks) -> PanelLook:
        config = self._facts.config
        white, projector, mask = (self._read(files[name]) for name in (WHITE, PROJECTOR, MASK))
        photos = BlockPhotos(
            white=_light(white),
            projector=_light(projector),
            mask=_light(mask),
            known=~(white.saturated | projector.saturated | mask.saturated),
        )
        camera = camera_map(config, white.frame)
        panels = panels_of(config)
        return panel_look(photos, blocks, camera, (panels.projector.map, panels.mask.map))

    def _read(self, file: tuple[str, str]) -> RawFrame:
        raw, sha256 = file
        profile, iso = self._facts.profile, self._exposer.iso
        saturation = profile.saturation_dn(iso)
        return read_raw(self._folder / raw, sha256=sha256, saturation_dn=saturation)


def _nobody_looked(why: str) -> PanelLook:
    return PanelLook(mask=None, camera=None, rest_px=0.0, direct=0.0, mask_seen=False, why=why)


def _light(frame: RawFrame) -> Floats:
    """Grey light of quads, (h, w)."""
    return np.asarray(frame.planes.mean(axis=0), dtype=np.float64)
