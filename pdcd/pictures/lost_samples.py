"""Samples of a run's photos that tell nothing, though their files do not say so."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pdcd.arrays import Bools
from pdcd.sensor.dead import find_full_level, mark_full_samples
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import RawFrame


@dataclass
class LostSamples:
    """For the darkroom. dead : (h, w), quads that are dead by a white shot, None before one tells.
    full_dn : by ISO, where full samples end below what the profile says."""

    dead: Bools | None = None
    full_dn: dict[int, float] = field(default_factory=dict)

    def mark_full(self, raw: RawFrame, profile: SensorProfile, iso: int) -> RawFrame:
        """The same with full samples as saturated ones, by where those of this photo or of one
        before end; a warning says so."""
        found = find_full_level(raw, profile, iso)
        if found is not None:
            self.full_dn[iso] = min(found, self.full_dn.get(iso, found))
        level = self.full_dn.get(iso)
        if level is None:
            return raw
        said = (
            f"samples end at {100.0 * level / profile.saturation_dn(iso):.0f} % of the sensor "
            "profile's saturation: these are saturated; measure the sensor (pdcd calibrate sensor)"
        )
        return replace(mark_full_samples(raw, level), doubts=(*raw.doubts, said))
