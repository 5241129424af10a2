"""Calibration folders that no bench has made, for tests of how they are chosen and used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from pdcd.bench.calibration import (
    CALIBRATION_DIGEST,
    RECORD,
    BenchIdentity,
    Calibration,
    CameraRecord,
    MeasuredValue,
    encode_calibration,
    format_digest_line,
)


def entry(value: Any) -> MeasuredValue:
    return MeasuredValue(value=value, step="light", made_utc="2026-01-01T00:00:00Z")


def record(**changed: Any) -> Calibration:
    """Of the mock bench, good, with nothing measured, but for what is given."""
    identity = BenchIdentity(
        rig="mock bench", camera_model="m", camera_serial="s", frame_quads=None, flip=None,
        projector="p", mask="q", projector_hz=60.0, mask_hz=60.0, iso=100, f_number=None,
    )  # fmt: skip
    camera = CameraRecord(
        model="m", serial="s", profile="modern", responsivity_e=(1.0, 2.0, 3.0), isos=(100, 200),
        f_numbers=(2.8, 4.0), frame_quads=(30, 20),
    )  # fmt: skip
    whole = Calibration(
        schema=1, name="cal", version="0", started_utc="2026-01-01T00:00:00Z",
        finished_utc="2026-01-01T12:00:00Z", verdict="good", identity=identity, belief={},
        camera=camera, profile={}, measured={}, steps=(), before=None, files={},
    )  # fmt: skip
    return msgspec.structs.replace(whole, **changed)


def of_rig(name: str) -> BenchIdentity:
    return msgspec.structs.replace(record().identity, rig=name)


def written(folder: Path, told: Calibration) -> Path:
    """A folder that holds it."""
    folder.mkdir(parents=True)
    data = encode_calibration(told)
    (folder / RECORD).write_bytes(data)
    (folder / CALIBRATION_DIGEST).write_bytes(format_digest_line(data))
    return folder
