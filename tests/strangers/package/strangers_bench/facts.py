"""What a bench really is, drawn by a seed; a file of these facts is all that its drivers read."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ENGRAVED = (
    1.4, 1.6, 1.8, 2.0, 2.2, 2.5, 2.8, 3.2, 3.5, 4.0, 4.5, 5.0, 5.6, 6.3, 7.1, 8.0, 9.0, 10.0,
    11.0, 13.0, 14.0, 16.0, 18.0, 20.0, 22.0, 25.0, 29.0, 32.0, 36.0, 40.0, 45.0,
)  # fmt: skip
"""What the ring of the lens says; its stops lie near the sixth roots of powers of two."""
FIRST_STOP = 3
"""f/1.4 is two to the power of 3/6."""

CAMERAS = {
    # width and height in quads, bits, black DN, white DN, gain e-/DN, read noise e-, full well e-
    "coarse": ((300, 225), 14, 1024, 15800, 2.9, 16.0, 41000.0),
    "small": ((200, 150), 14, 1024, 15800, 2.9, 16.0, 41000.0),
    "tiny": ((96, 72), 14, 1024, 15800, 2.9, 16.0, 41000.0),
    "fine": ((360, 270), 12, 64, 4095, 7.4, 6.0, 29500.0),
}
SCENES = ("fold", "marble", "mirror", "relief")


@dataclass(frozen=True)
class PlaceFacts:
    """How a device lies before the scene; lengths in pixels of the projector."""

    turn_deg: float
    width_px: float
    """Of its picture on the scene."""
    offset_px: tuple[float, float]
    mirrored: bool
    keystone: tuple[float, float]
    """By how much it shrinks from the middle to the right edge, and to the lower one."""
    bulge: float
    """Lens: points at half the height from the middle lie so much further out."""


@dataclass(frozen=True)
class PanelFacts:
    """How a panel shows its pixels; times in s."""

    size_px: tuple[int, int]
    late_s: float
    """From the refresh to the light of the first row that is set."""
    scan_s: float
    """From the first row that is set to the last; below zero it sets the lowest first."""
    rise_s: float
    fall_s: float
    contrast: float
    gamma: float


@dataclass(frozen=True)
class Facts:
    """One bench."""

    seed: int
    projector: PanelFacts
    mask: PanelFacts
    mask_place: PlaceFacts
    camera_place: PlaceFacts
    camera: str
    falloff: float
    """Light that the projector's lens loses in the corners, as a share."""
    vignetting: float
    """The same of the camera's lens."""
    blur_px: float
    """Of the scene on the mask: standard deviation."""
    blur_quads: float
    """Of the mask on the sensor."""
    room: float
    """Light of the room on the scene, over the projector's white in the middle."""
    room_tilt: float
    """By which share it is brighter at the right edge than at the left."""
    stops: tuple[float, ...]
    """Light of each engraved stop is that of this f-number."""
    responsivity_e: tuple[float, float, float]
    """Electrons per second at f/1 of a perfect white in the middle of the projector's light."""
    gain: float
    read_noise: float
    """Factors on the data sheet's."""
    lag_s: float
    jitter_s: float
    scene: str

    def save(self, path: Path) -> None:
        """Write them as JSON."""
        path.write_text(json.dumps(dataclasses.asdict(self), indent=1))

    @classmethod
    def load(cls, path: Path) -> Facts:
        """Read what `save` wrote."""
        found: dict[str, Any] = json.loads(path.read_text())
        kinds: tuple[tuple[str, Any], ...] = (
            ("projector", PanelFacts), ("mask", PanelFacts),
            ("mask_place", PlaceFacts), ("camera_place", PlaceFacts),
        )  # fmt: skip
        for key, kind in kinds:
            part = {k: tuple(v) if isinstance(v, list) else v for k, v in found[key].items()}
            found[key] = kind(**part)
        plain: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in found.items()
        }
        return cls(**plain)


def draw_facts(seed: int, *, small: bool = False) -> Facts:
    """The bench of a seed; `small` has fewer pixels throughout, for tests that must be quick."""
    rng = np.random.default_rng([seed, 77])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def times(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def pair(most: float) -> tuple[float, float]:
        return between(-most, most), between(-most, most)

    projector_px = (360, 270) if small else ((640, 480) if seed % 4 != 2 else (800, 600))
    mask_px = (400, 300) if small else ((640, 480) if seed % 2 else (800, 600))
    width = float(projector_px[0])
    cover = between(0.70, 1.10)
    camera = "small" if small else "coarse" if seed % 2 else "fine"
    scan_s = 0.0155
    mask_up = bool(rng.integers(2))
    bright = times(0.6, 1.6)
    return Facts(
        seed=seed,
        projector=PanelFacts(
            projector_px, between(0.0, 0.001), scan_s * between(0.9, 1.02),
            between(0.0008, 0.003), between(0.0006, 0.003), times(500.0, 2500.0), between(1.8, 2.4),
        ),
        mask=PanelFacts(
            mask_px, between(0.001, 0.006) + (0.0166 if rng.random() < 0.25 else 0.0),
            scan_s * between(0.9, 1.02) * (-1.0 if mask_up else 1.0),
            between(0.002, 0.006), between(0.002, 0.007), times(250.0, 900.0), between(1.6, 2.4),
        ),
        mask_place=PlaceFacts(
            between(-3.0, 3.0), width * float(np.sqrt(cover)), pair(45.0 * width / 800.0),
            bool(rng.random() < 0.35), pair(0.008), between(-0.003, 0.003),
        ),
        camera_place=PlaceFacts(
            between(-3.0, 3.0), width * between(1.04, 1.14), pair(20.0 * width / 800.0),
            bool(rng.random() < 0.2), pair(0.01), between(-0.012, 0.012),
        ),
        camera=camera,
        falloff=between(0.05, 0.35),
        vignetting=between(0.1, 0.4),
        blur_px=between(0.2, 1.0),
        blur_quads=between(0.4, 0.9),
        room=0.0 if seed % 5 == 0 else between(0.0, 0.05),
        room_tilt=between(-0.3, 0.3),
        stops=tuple(
            float(2.0 ** ((k + FIRST_STOP) / 6.0) * (1.0 + rng.uniform(-0.01, 0.01)))
            for k in range(len(ENGRAVED))
        ),
        responsivity_e=(0.55e6 * bright, 1.0e6 * bright, 0.7e6 * bright),
        gain=between(0.93, 1.07),
        read_noise=between(0.85, 1.25),
        lag_s=between(0.03, 0.09),
        jitter_s=between(0.0005, 0.002),
        scene=SCENES[seed % len(SCENES)],
    )  # fmt: skip
