"""Light transport under a projector that is not equally bright everywhere."""

from __future__ import annotations

from dataclasses import dataclass

from pdcd.virtual.scene.effects import Array, Cells, Effect


@dataclass(frozen=True, eq=False)
class IlluminatedEffect:
    """An effect whose cells get `light` (N,) when full light is asked for: its columns scaled."""

    effect: Effect
    light: Array

    @property
    def name(self) -> str:
        """See `Effect.name`."""
        return self.effect.name

    @property
    def coaxial(self) -> bool:
        """See `Effect.coaxial`."""
        return self.effect.coaxial

    @property
    def tint(self) -> Array:
        """See `Effect.tint`."""
        return self.effect.tint

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        return self.effect.apply(light * self.light)

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`."""
        return self.effect.probe(left, right * self.light)

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        return self.effect.diagonal() * self.light

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        return self.effect.entries(seen, lit) * self.light[lit]

    def dense(self) -> Array:
        """See `Effect.dense`."""
        return self.effect.dense() * self.light
