"""How the photos of a job are exposed: ISO, and the aperture of each program by test exposures."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from pdcd.bench.devices import CameraInfo, CameraSettings
from pdcd.bench.placed import camera_map
from pdcd.capture.worker.answers import Facts, Note, Order, Photo, Taken, Wanted
from pdcd.errors import ConfigError
from pdcd.planning.metering import (
    MAX_TESTS,
    Floats,
    expected_share,
    metered_pairs,
    next_aperture,
    peak_share,
)
from pdcd.planning.plan import ShotSequence
from pdcd.runs.record import MeterRecord
from pdcd.sensor.cells import CellMap
from pdcd.sensor.raw import read_raw

FIRST_F_NUMBER = 8.0
"""Aperture of the first test exposure."""

Exposing = Generator[Order, Taken, float]


class Orders:
    """Makes the orders of a job; a note waits for the next one."""

    def __init__(self) -> None:
        self._notes: list[Note] = []

    def note(self, *notes: Note) -> None:
        """To be told and kept before anything else is done with the devices."""
        self._notes += notes

    def tell(self, note: Note) -> Order:
        """To be told and kept before work that takes long."""
        self.note(note)
        return Order(self._noted())

    def expose(self, wanted: Wanted) -> Generator[Order, Taken, Taken]:
        """To have a photo taken; returns what came of it."""
        return (yield Order(self._noted(), wanted))

    def end(self) -> Order:
        """Nothing more is wanted."""
        return Order(self._noted(), done=True)

    def _noted(self) -> tuple[Note, ...]:
        notes, self._notes = tuple(self._notes), []
        return notes


@dataclass
class Exposer:
    """Settings of the camera for one job, whose photos lie in `folder`.

    iso : as planned; None for the lowest. apertures : metered f-number of each program, one for all
    its parts; white shots have none, so theirs is under ''.
    """

    facts: Facts
    camera: CameraInfo
    planned_iso: int | None
    folder: Path
    orders: Orders
    apertures: dict[str, float] = field(default_factory=dict)

    @property
    def iso(self) -> int:
        """The ISO of all exposures. Raises ConfigError for one that the camera does not offer."""
        iso, offered = self.planned_iso, self.camera.isos
        if iso is None:
            return min(offered)
        if iso not in offered:
            raise ConfigError(
                f"ISO {iso} is not offered",
                device="camera",
                hint=f"take one of {', '.join(map(str, offered))}",
            )
        return iso

    def settings(self, f_number: float) -> CameraSettings:
        """What the camera is set to; a lens that cannot be set is left as it is."""
        return CameraSettings(self.iso, f_number if self.camera.f_numbers else None)

    def aperture(self, program: str, shot: str, sequence: ShotSequence) -> Exposing:
        """The f-number of a shot of a program: as configured, or by test exposures, once for each
        program. Raises ConfigError for a lens that has to be set by hand."""
        asked = self.facts.config.camera.f_number
        if asked != "auto":
            return asked
        if not self.camera.f_numbers:
            raise ConfigError(
                "this lens cannot be set from here",
                device="camera",
                hint="set camera.f_number to what its ring says",
            )
        if program not in self.apertures:
            self.apertures[program] = yield from self._metered(shot, sequence)
        return self.apertures[program]

    def _metered(self, shot: str, sequence: ShotSequence) -> Exposing:
        """The f-number that test exposures lead to."""
        saturation_dn = self.facts.profile.saturation_dn(self.iso)
        pairs, ratio = metered_pairs(sequence)
        apertures = self.camera.f_numbers
        f_number = min(apertures, key=lambda f: abs(f - FIRST_F_NUMBER))
        for test in range(1, MAX_TESTS + 1):
            frames, settings = sequence.frames(pairs), self.settings(f_number)
            wanted = Wanted("test", f"meter-{shot}-{test}", frames, settings, f_number)
            photo = cast(Photo, (yield from self.orders.expose(wanted)))
            shares = [self._shares(*plane, ratio, saturation_dn) for plane in photo.planes]
            peak, expected = (max(values) for values in zip(*shares, strict=True))
            self.orders.note(MeterRecord(raw=photo.raw, f_number=f_number, peak=peak))
            f_number, settled = next_aperture(apertures, f_number, peak, expected)
            if settled:
                return f_number
        self.orders.note(f"metering of {shot} did not settle; took f/{f_number:g}")
        return f_number

    def _shares(
        self, raw: str, sha256: str, ratio: Floats, saturation_dn: float
    ) -> tuple[float, float]:
        """A test exposure: its brightest sample, and that of the real exposure at the same
        aperture, as shares of saturation. Raises DecodeError."""
        frame = read_raw(self.folder / raw, sha256=sha256, saturation_dn=saturation_dn)
        config = self.facts.config
        cells = CellMap(
            grid=self.facts.grid,
            frame=frame.frame,
            map=camera_map(config, frame.frame),
            blur_quads=config.camera.blur_quads,
        )
        return (
            peak_share(frame.planes, frame.saturated, saturation_dn),
            expected_share(frame.planes, ratio, saturation_dn, cells),
        )
