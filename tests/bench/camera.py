"""How fast a photo comes over the virtual USB: what the client costs, not what a cable does."""

from __future__ import annotations

import hashlib
import os
import struct
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from drivers.ptp.codes import Operation
from drivers.ptp.files import store_photo, wait_for_photo
from drivers.virtual_camera import PlainFilm
from tests.bench.measure import timed
from tests.bench.tables import Aim, Section, Table, seconds
from tests.ptp_rig import PtpRig

PHOTO_B = 24_000_000
PACKET_B = 512
AIM_B_PER_S = 100e6
REPEATS = 5


def run(*, quick: bool, folder: Path) -> Section:
    """Measure in this process."""
    raw = b"II*\0" + os.urandom(PHOTO_B - 4)
    # On the card, so that it can be fetched time after time.
    rig = PtpRig(film=PlainFilm(lambda _: raw), camera={"destination": "card"})
    rig.connect()
    rig.expose(0.1)
    photo = wait_for_photo(rig.camera, rig.clock.now_ns() + 1_000_000_000)
    if photo is None:
        raise RuntimeError("the virtual camera made no photo")
    with tempfile.TemporaryDirectory() as place:
        ways = {
            "ptp, read twice and compared (default)": partial(_driver, rig, photo, place, True),
            "ptp, read once": partial(_driver, rig, photo, place, False),
            "packet by packet, joined": partial(_by_packets, rig, photo.handle, place),
        }
        times = {}
        for name, way in ways.items():
            times[name], digest = timed(way, REPEATS)
            if digest != hashlib.sha256(raw).hexdigest():
                raise RuntimeError(f"{name}: the photo is damaged")
    rig.disconnect_quietly()
    table = Table("A photo of 24 MB from the virtual camera", ("way", "time", "MB/s"))
    for name, way_s in times.items():
        table.add(name, seconds(way_s), f"{PHOTO_B / way_s / 1e6:.0f}")
    return Section(
        title="Photos over PTP",
        text=(
            "The `ptp` readout fetches a photo through pyusb from the virtual camera: blocks of "
            "1 MiB into one buffer, hashed and written from there. The virtual USB has no speed "
            f"of its own. Medians of {REPEATS}."
        ),
        tables=[table],
        aims=[
            Aim(
                "photo of 24 MB over the virtual USB, read twice and compared",
                "s",
                times["ptp, read twice and compared (default)"],
                PHOTO_B / AIM_B_PER_S,
            )
        ],
    )


def _driver(rig: PtpRig, photo: Any, place: str, twice: bool) -> str:
    path = Path(place) / "photo.cr2"
    path.unlink(missing_ok=True)
    raw = store_photo(rig.camera, photo, path, twice=twice)
    return "" if raw is None else raw.sha256


def _by_packets(rig: PtpRig, handle: int, place: str) -> str:
    """GetObject, one USB packet a read, all of them joined: the plain way to write it."""
    transport: Any = rig.camera.session._transport
    device, number = transport._port._device, transport._next_id
    transport._next_id += 1
    packets: list[bytes] = []
    with rig.camera.session.hold():
        device.write(0x02, struct.pack("<IHHII", 16, 1, Operation.GET_OBJECT, number, handle), 1000)
        while not packets or len(packets[-1]) == PACKET_B:
            packets.append(device.read(0x81, PACKET_B, 1000).tobytes())
        device.read(0x81, PACKET_B, 1000)  # the response
    data = b"".join(packets)[12:]
    (Path(place) / "plain.cr2").write_bytes(data)
    return hashlib.sha256(data).hexdigest()
