"""Settings for the photos of a job: ISO, and the aperture of each program by test exposures."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import cast

import msgspec
import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.bench.devices import CameraInfo, CameraSettings
from pdcd.bench.placed import make_camera_map
from pdcd.bench.stops import Stop, compute_light_sigma, stop_of
from pdcd.capture.worker.answers import (
    AuxiliaryPhoto,
    Order,
    OrderNote,
    PhotoOrder,
    PhotoOutcome,
    RigFacts,
    SpoiltPhoto,
)
from pdcd.errors import ConfigError, PdcdError
from pdcd.panels.frames import Frames
from pdcd.planning.metering import (
    MAX_TESTS,
    USABLE,
    can_share_stop,
    choose_next_aperture,
    choose_test_pairs,
    compare_stops,
    count_stop_repeats,
    fit_white_slots,
    measure_peak_share,
    pick_leading_shot,
    predict_peak_share,
)
from pdcd.planning.plan import ShotSequence
from pdcd.recipes.recipe import Shot
from pdcd.runs.record import DarkPhoto, MeterRecord
from pdcd.sensor.cells import CellMap
from pdcd.sensor.dead import (
    can_tell_samples,
    find_full_level,
    find_stuck_samples,
    mark_full_samples,
)
from pdcd.sensor.raw import RawFrame
from pdcd.sensor.shelf import PhotoShelf

_FIRST_F_NUMBER = 8.0
"""Aperture of the first test exposure."""

_Exposing = Generator[Order, PhotoOutcome, float]
_Shows = Callable[[Shot], ShotSequence]
"""What the panels show in a shot of a plan."""


class Orders:
    """Makes the orders of a job; a note waits for the next one."""

    def __init__(self) -> None:
        self._notes: list[OrderNote] = []

    def note(self, *notes: OrderNote) -> None:
        """Have notes reported and kept before anything else is done with the devices."""
        self._notes += notes

    def tell(self, note: OrderNote) -> Order:
        """An order to report and keep a note, before work that takes long."""
        self.note(note)
        return Order(self._noted())

    def expose(self, wanted: PhotoOrder) -> Generator[Order, PhotoOutcome, PhotoOutcome]:
        """Have a photo taken; returns its result."""
        return (yield Order(self._noted(), wanted))

    def look(
        self, wanted: PhotoOrder
    ) -> Generator[Order, PhotoOutcome, AuxiliaryPhoto | SpoiltPhoto]:
        """Have a dark photo or one of pixels taken, without which a run goes on; the caller handles
        a spoilt one. Raises PdcdError for any other result."""
        taken = yield from self.expose(wanted)
        if not isinstance(taken, AuxiliaryPhoto | SpoiltPhoto):
            raise PdcdError(f"photo {wanted.name} was asked for, and something else came")
        return taken

    def end(self) -> Order:
        """Nothing more is wanted."""
        return Order(self._noted(), done=True)

    def _noted(self) -> tuple[OrderNote, ...]:
        notes, self._notes = tuple(self._notes), []
        return notes


def make_dark_photo(photo: AuxiliaryPhoto, wanted: PhotoOrder, phase_s: float) -> DarkPhoto:
    """The record of such a photo; phase_s : how long each of its states was shown."""
    return DarkPhoto(
        raw=photo.raw,
        sha256=photo.planes[0][1],
        iso=wanted.settings.iso,
        f_number=wanted.f_number,
        exposure_s=photo.seconds,
        phase_s=phase_s,
    )


@dataclass
class Exposer:
    """Settings of the camera for one job, whose photos lie on `shelf`.

    All photos share one ISO, and one aperture wherever their light allows that, because the light
    of two stops never differs exactly as engraved.

    iso : as planned; None for the lowest. stops : of the run, its own first; the light of others is
        compared with that on the scene. apertures : f-number of each kind of shot, one for all its
        parts; white shots have no kind, so theirs is under ''. per_slot : share of saturation that
        each slot of a white shot gives at the run's own stop.
    """

    facts: RigFacts
    camera: CameraInfo
    planned_iso: int | None
    shelf: PhotoShelf
    orders: Orders
    apertures: dict[str, float] = field(default_factory=dict)
    stops: tuple[Stop, ...] = ()
    per_slot: float = 0.0
    _alone: dict[float, Bools] = field(default_factory=dict, init=False)
    """Samples that were saturated without light, by the f-number of the test."""

    def __post_init__(self) -> None:
        asked = self.facts.config.camera.f_number
        if asked != "auto":
            self._begin(asked)

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

    def white_slots(self, planned: int) -> int:
        """Slots of a white shot, given the planned number."""
        return fit_white_slots(self.per_slot, planned) if self.per_slot else planned

    def aperture(self, shot: Shot, planned: Sequence[Shot], shown: _Shows) -> _Exposing:
        """The f-number of a shot among those that are `planned`: as configured, or by test
        exposures, once for each kind. shown : what the panels show in a shot. Raises ConfigError
        for a lens that has to be set by hand."""
        asked = self.facts.config.camera.f_number
        if asked != "auto":
            return asked
        if not self.camera.f_numbers:
            raise ConfigError(
                "this lens cannot be set from here",
                device="camera",
                hint="set camera.f_number to what its ring says",
            )
        if not self.stops:
            lead = pick_leading_shot(planned)
            first = min(self.camera.f_numbers, key=lambda f: abs(f - _FIRST_F_NUMBER))
            self.apertures[lead.kind] = yield from self._metered(lead, shown(lead), first)
            self._begin(self.apertures[lead.kind])
        if shot.kind not in self.apertures:
            if shot.of_leaks:  # what leaks says nothing of the light of those that share its stop
                lit = (one for one in planned if one.kind == shot.kind and not one.of_leaks)
                shot = next(lit, shot)
            own, sequence = self.stops[0].f_number, shown(shot)
            found = yield from self._metered(shot, sequence, own, join=True)
            if found != own:
                dim = pick_leading_shot(planned) if found > own else shot
                yield from self._compare(shot.name, shown(dim), found)
            self.apertures[shot.kind] = found
        return self.apertures[shot.kind]

    def find_aperture(self, shot: Shot) -> float:
        """The f-number of a shot that was taken."""
        asked = self.facts.config.camera.f_number
        return self.apertures[shot.kind] if asked == "auto" else asked

    def _begin(self, f_number: float) -> None:
        """Make this the run's own stop."""
        known = stop_of(f_number, self.facts.config.camera.stops)
        self.stops = (msgspec.structs.replace(known, sigma=0.0),)

    def _metered(
        self, shot: Shot, sequence: ShotSequence, f_number: float, *, join: bool = False
    ) -> _Exposing:
        """The f-number that test exposures lead to, of which the first is at `f_number`; with
        `join`, `f_number` itself if the shot can be taken at it."""
        saturation_dn = self.facts.profile.saturation_dn(self.iso)
        pairs, ratio = choose_test_pairs(sequence)
        frames, apertures = sequence.frames(pairs), self.camera.f_numbers
        for test in range(1, MAX_TESTS + 1):
            photo = yield from self._test(f"meter-{shot.name}-{test}", frames, f_number)
            shares = [
                self._shares(*plane, f_number, ratio, saturation_dn) for plane in photo.planes
            ]
            peak, expected = (max(values) for values in zip(*shares, strict=True))
            self.orders.note(MeterRecord(raw=photo.raw, f_number=f_number, peak=peak))
            if join and test == 1 and peak < USABLE[1]:
                if can_share_stop(shot, expected, sequence.passes):
                    self.per_slot = expected / sequence.passes if shot.white else self.per_slot
                    return f_number
            f_number, settled = choose_next_aperture(apertures, f_number, peak, expected)
            if settled:
                return f_number
        self.orders.note(f"metering of {shot.name} did not settle; took f/{f_number:g}")
        return f_number

    def _test(
        self, name: str, frames: Frames, f_number: float
    ) -> Generator[Order, PhotoOutcome, AuxiliaryPhoto]:
        """One test exposure."""
        wanted = PhotoOrder("test", name, frames, self.settings(f_number), f_number)
        return cast(AuxiliaryPhoto, (yield from self.orders.expose(wanted)))

    def _compare(
        self, name: str, sequence: ShotSequence, f_number: float
    ) -> Generator[Order, PhotoOutcome, None]:
        """Compare the light of another stop, for the shot `name`, with that of the run's own, by
        two photos of a sequence that is not too bright for the wider one. Where these are too dark,
        the stop is recorded as it is known without them."""
        own, known = self.stops[0], {stop.f_number for stop in self.stops}
        if f_number in known:
            return
        pairs = choose_test_pairs(sequence)[0]
        wide = min(own.f_number, f_number)
        raws, shown, saturation_dn = [], [], self.facts.profile.saturation_dn(self.iso)
        for number, each in enumerate((own.f_number, f_number), 1):
            shown.append(count_stop_repeats(wide, each))
            frames = sequence.frames(pairs, shown[-1])
            photo = yield from self._test(f"stop-{name}-{number}", frames, each)
            self.orders.note(MeterRecord(raw=photo.raw, f_number=each, peak=None))
            raws.append(self._read(*photo.planes[0], saturation_dn))
        one, other = raws
        compared = compare_stops(one, other, self.facts.profile, self.iso, photo.seconds)
        takes = f"shot {name} takes f/{f_number:g} and not f/{own.f_number:g}"
        if compared is None:
            measured = self.facts.config.camera.stops
            stop = stop_of(f_number, measured)
            sigma = compute_light_sigma(stop_of(own.f_number, measured), stop)
            self.stops = (*self.stops, msgspec.structs.replace(stop, sigma=sigma))
            self.orders.note(
                f"{takes}: there is too little light to compare the two; pictures rely on what is "
                f"known of both, to {100.0 * sigma:.2g} %"
            )
            return
        ratio, sigma = compared
        true = own.true * float(np.sqrt(ratio * shown[1] / shown[0]))
        self.stops = (*self.stops, Stop(f_number, true, sigma))
        self.orders.note(
            f"{takes}: their light was compared on the scene, to {100.0 * sigma:.2g} %"
        )

    def _shares(
        self, raw: str, sha256: str, f_number: float, ratio: Floats, saturation_dn: float
    ) -> tuple[float, float]:
        """Of a test exposure: its brightest sample, and that of the real exposure at the same
        aperture, as shares of saturation. Samples that are saturated by themselves at any aperture
        are stuck, and do not count. Raises DecodeError."""
        frame = self._read(raw, sha256, saturation_dn)
        level = find_full_level(frame, self.facts.profile, self.iso)
        frame = frame if level is None else mark_full_samples(frame, level)
        config = self.facts.config
        cells = CellMap(
            grid=self.facts.grid,
            frame=frame.frame,
            map=make_camera_map(config, frame.frame),
            blur_quads=config.camera.blur_quads,
        )
        planes, saturated = frame.planes, frame.saturated
        if saturated.any() and can_tell_samples(cells):
            alone = find_stuck_samples(frame, saturation_dn)
            others = [found for other, found in self._alone.items() if other != f_number]
            stuck = alone & np.logical_or.reduce([np.zeros_like(alone), *others])
            self._alone[f_number] = alone
            planes, saturated = np.where(stuck, np.float32(0.0), planes), saturated & ~stuck
        return (
            measure_peak_share(planes, saturated, saturation_dn),
            predict_peak_share(planes, ratio, saturation_dn, cells),
        )

    def _read(self, raw: str, sha256: str, saturation_dn: float) -> RawFrame:
        return self.shelf.read(raw, sha256=sha256, saturation_dn=saturation_dn)
