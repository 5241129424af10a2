"""A virtual DLPC900 and its client, for tests of what the device takes and shows."""

from __future__ import annotations

import numpy as np

from drivers.virtual_dlpc900 import (
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdModel,
    VirtualDmdOptions,
    choose_dmd_model,
)
from pdcd.bench.clock import VirtualClock
from tests.dmd_client import (
    START,
    DmdClient,
    entry_bytes,
    make_image,
)

SIZE = (16, 8)
BLACK_IMAGE = make_image(np.zeros((8, 16), np.uint32))


class VirtualDmdRig:
    """One device, stopped and in on-the-fly mode unless told otherwise, and its client."""

    def __init__(
        self,
        options: VirtualDmdOptions | None = None,
        model: VirtualDmdModel | None = None,
        *,
        begun: bool = True,
    ) -> None:
        self.clock = VirtualClock()
        self.device = VirtualDlpc900(
            self.clock, model or choose_dmd_model(SIZE), "A1", options or VirtualDmdOptions()
        )
        self.client = DmdClient(VirtualDmdBus(self.device))
        if begun:
            self.client.begin()

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def planes(self, count: int) -> list[list[list[int]]]:
        """What the first patterns of a sequence show, from its start on."""
        begun_ns = self.clock.now_ns()
        self.client.run(START)
        self.wait(0.05)
        shown = [
            (plane.words >> plane.bit & 1).tolist()
            for _, plane in self.device.list_changes(begun_ns, self.clock.now_ns())
            if plane is not None
        ]
        return shown[:count]


def report(*head: int) -> bytes:
    return bytes(head).ljust(64, b"\0")


def entry(**changes: int) -> bytes:
    values = {"index": 0, "exposure_us": 105, **changes}
    return entry_bytes(**values)  # type: ignore[arg-type]
