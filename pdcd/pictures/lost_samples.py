"""Dead and saturated samples of a run's photos that their files do not mark."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pdcd.arrays import Bools
from pdcd.sensor.dead import find_full_level, mark_full_samples
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import RawFrame


@dataclass
class LostSamples:
    """For the darkroom. dead : (h, w), quads that a white shot showed to be dead; None before one
    was looked at. full_dn : by ISO, the level of full samples where it is below the profile's."""

    dead: Bools | None = None
    full_dn: dict[int, float] = field(default_factory=dict)

    def mark_full(self, raw: RawFrame, profile: SensorProfile, iso: int) -> RawFrame:
        """The frame with full samples marked as saturated, by their level in this photo or in one
        before; a warning says so."""
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
