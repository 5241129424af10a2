"""What the doctor says of two DMDs, and what its bars tell of the order of planes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from drivers.dlpc900.doctor import examine_dlpc900
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext, Finding, SharedState
from pdcd.errors import DeviceLost
from tests.dlpc900_rig import Dlpc900Rig


class WatchedClock(VirtualClock):
    """Looks at the panels when somebody waits for long."""

    def __init__(self, seen: list[list[float]]) -> None:
        super().__init__()
        self.seen = seen
        self.rig: Dlpc900Rig | None = None

    def sleep_until_ns(self, t_ns: int) -> None:
        if self.rig is not None and t_ns - self.now_ns() > 150_000_000 and not self.seen:
            for dmd in self.rig.dmds:
                light = sum(
                    dmd.plane(*dmd.place_of(n))[0]
                    * float(dmd.entries[n][2] + 256 * dmd.entries[n][3])
                    for n in range(dmd.table[0])
                )
                self.seen.append(np.asarray(light).reshape(24, -1).mean(axis=1).tolist())
        super().sleep_until_ns(t_ns)


def examined(**options: Any) -> tuple[list[Finding], list[list[float]]]:
    seen: list[list[float]] = []
    clock = WatchedClock(seen)
    rig = clock.rig = Dlpc900Rig(clock=clock, **options)
    context = DriverContext(rig.config(), clock, SharedState(usb_backend=rig.usb))
    found = list(examine_dlpc900(context))
    assert not rig.usb.claimed and all(dmd.black for dmd in rig.dmds)
    return found, seen


def test_bars_get_brighter_from_left_to_right() -> None:
    found, seen = examined()
    for light in seen:
        assert len(light) == 24
        np.testing.assert_allclose(np.array(light) / light[0], np.arange(1, 25))
    states = {one.what: one.state for one in found}
    assert states == {
        "DLPC900": "good", "projector": "good", "firmware of the projector": "good",
        "mask": "good", "firmware of the mask": "good", "rows": "good", "dark times": "warning",
        "planes": "unknown",
    }  # fmt: skip


@pytest.mark.parametrize("order", ["BGR", "RGB", "RBG", "GRB", "BRG"])
def test_thirds_by_brightness_are_the_right_order(order: str) -> None:
    """The devices take "GBR"; whatever is set, the hint's rule leads there."""
    _, (light, _) = examined(plane_order=order)
    thirds = [sum(light[8 * n : 8 * n + 8]) for n in range(3)]
    assert "".join(order[n] for n in np.argsort(thirds)) == "GBR"


def test_what_fails_is_a_finding() -> None:
    rig = Dlpc900Rig(mask="C")
    context = DriverContext(rig.config(), rig.clock, SharedState(usb_backend=rig.usb))
    found = list(examine_dlpc900(context))
    assert [one.found for one in found[:2]] == [
        "A on port 1-2.1", "B on port 1-2.2; not of this bench",
    ]  # fmt: skip
    assert found[2].state == "fault" and "no DLPC900 is 'C'" in found[2].found
    rig = Dlpc900Rig(start="never")
    context = DriverContext(rig.config(), rig.clock, SharedState(usb_backend=rig.usb))
    (fault,) = examine_dlpc900(context)
    assert fault.state == "fault" and "start" in fault.found


def test_a_device_lost_meanwhile_is_a_finding() -> None:
    rig = Dlpc900Rig()

    def leave(number: int) -> None:
        if number > 60:
            raise DeviceLost("gone")

    rig.dmds[0].on_report = leave
    context = DriverContext(rig.config(), rig.clock, SharedState(usb_backend=rig.usb))
    found: Iterator[Finding] = examine_dlpc900(context)
    assert list(found)[-1].state == "fault"


def test_a_bench_of_one_start_apart_is_warned_of() -> None:
    found, _ = examined(start="software")
    (warning,) = [one for one in found if one.what == "panels"]
    assert warning.state == "warning" and "connect a trigger" in str(warning.hint)
