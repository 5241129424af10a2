"""A mock bench with a hidden truth, and hands that take the photos a step asks for."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from pdcd.bench.devices import CameraSettings
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.tables import Config
from pdcd.bench.truth import load_bench_truth
from pdcd.calibration.check.check_step import check_bench
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    PhotoRequest,
    StepOutcome,
    StepScript,
)
from pdcd.calibration.shown import pack_frames
from pdcd.capture.rig import Rig
from pdcd.panels.placing import Placing
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import read_raw


@dataclass
class Hands:
    """Takes photos on a bench, step after step. session : what is known so far."""

    config: Config
    folder: Path
    full: int = 240
    f_number: float = 36.0
    session: CalibrationSession = field(init=False)
    photos: int = 0

    def __post_init__(self) -> None:
        self.rig = Rig(self.config)
        self.rig.connect()
        assert self.rig.camera_info is not None
        camera = self.rig.camera_info
        profile = load_profile(self.config.camera.profile)
        iso = self.config.camera.iso or min(camera.isos)
        stop = min(camera.f_numbers, key=lambda f: abs(f - self.f_number))
        self.session = CalibrationSession(self.config, profile, camera, iso, stop, self.full)

    def knows_maps(self) -> None:
        """As after a perfect geometry step."""
        true = load_bench_truth(self.config).of(self.config)
        assert self.config.camera.frame_quads is not None
        panels = panels_of(true)
        maps = {
            "projector": panels.projector.map,
            "mask": panels.mask.map,
            "camera": make_camera_map(true, self.config.camera.frame_quads[::-1]),
        }
        for name, map_ in maps.items():
            table = getattr(self.session.config, name)
            table = msgspec.structs.replace(table, place=Placing(map=map_))
            self.session.config = msgspec.structs.replace(self.session.config, **{name: table})

    def run(self, step: str, script: StepScript) -> StepOutcome:
        """Run a step to its end; the session learns what it found."""
        wanted = next(script)
        while True:
            try:
                assert isinstance(wanted, PhotoRequest)
                wanted = script.send(self._taken(wanted))
            except StopIteration as end:
                outcome: StepOutcome = end.value
                self.session.learn(step, outcome)
                return outcome

    def run_check(self) -> StepOutcome:
        """Run the check."""
        return self.run("check", check_bench(self.session))

    def _taken(self, wanted: PhotoRequest) -> CalibrationPhoto:
        self.photos += 1
        session = self.session
        iso = wanted.iso or session.iso
        done = self.rig.expose(
            pack_frames(wanted.shown),
            CameraSettings(iso, wanted.f_number or session.f_number),
            self.folder,
            f"{self.photos:03d}-{wanted.shown.name}",
            notify=lambda event: None,
            progress=lambda *at: None,
            cancelled=lambda: False,
        )
        raw = read_raw(
            done.raw.path,
            sha256=done.raw.sha256,
            size_bytes=done.raw.size_bytes,
            saturation_dn=session.profile.saturation_dn(iso),
        )
        done.raw.path.unlink()
        return CalibrationPhoto(wanted.shown.name, raw, done.log, done.open_ns, done.close_ns, iso)
