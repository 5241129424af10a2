"""When the virtual DLPC900 shows what, to the nanosecond: by the times of its entries, its trigger
lines and its crystal."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from typing import Literal

import numpy as np
import pytest

from drivers.virtual_dlpc900 import (
    PLANES_BY_TI,
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdFault,
    VirtualDmdOptions,
    VirtualDmdTiming,
    choose_dmd_model,
)
from pdcd.bench.clock import VirtualClock
from tests.dmd_client import START, STOP, DmdClient, entry_bytes

US = 1000
PLANES = np.arange(24)[:, None, None] // 2 ** np.arange(5)[None, None, :] % 2 > 0
"""Each plane has its number in its pixels, lowest bit first."""


class Shower:
    """A device with entries that show planes 0, 1, 2 ..."""

    def __init__(
        self,
        entries: Sequence[bytes],
        most: int | None = None,
        options: VirtualDmdOptions | None = None,
        faults: Sequence[VirtualDmdFault] = (),
    ) -> None:
        self.clock = VirtualClock()
        self.device = VirtualDlpc900(
            self.clock, choose_dmd_model((5, 1)), "A1", options or VirtualDmdOptions(), faults
        )
        self.client = DmdClient(VirtualDmdBus(self.device))
        self.client.upload(PLANES, entries, PLANES_BY_TI, most)

    def start(self) -> int:
        """Start, and say when the device took the command: one report after it was sent."""
        at_ns = self.clock.now_ns() + 1_000_000
        self.client.run(START)
        return at_ns

    def tick(self, at_ns: int, line: int = 1, *, width_us: int = 10) -> None:
        """A pulse at an input."""
        self.clock.sleep_until_ns(at_ns)
        self.device.drive_line(line, True, at_ns)  # type: ignore[arg-type]
        self.device.drive_line(line, False, at_ns + width_us * US)  # type: ignore[arg-type]

    def wait(self, us: int) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + us * US)

    def shown(self, low_ns: int, high_ns: int) -> list[tuple[int, int | None]]:
        """Changes in ns from `low_ns` on, and the number of the plane; those that change nothing
        are left out."""
        found: list[tuple[int, int | None]] = []
        for at_ns, plane in self.device.list_changes(low_ns, high_ns):
            number = None
            if plane is not None:
                bits = (plane.words >> plane.bit & 1).ravel()
                number = int(bits @ 2 ** np.arange(5))
            if found and found[-1][0] == at_ns - low_ns:
                found.pop()
            if not found or found[-1][1] != number:
                found.append((at_ns - low_ns, number))
        return found


def entries_of(*times_us: tuple[int, int], wait: Sequence[int] = ()) -> list[bytes]:
    """Entries of plane 1, 2, 3 ... by exposure and dark time."""
    return [
        entry_bytes(n, exposure, dark, 0, n + 1, wait=n in wait)
        for n, (exposure, dark) in enumerate(times_us)
    ]


THREE = ((105, 20), (200, 0), (300, 50))


def test_patterns_follow_each_other_by_their_times() -> None:
    rig = Shower(entries_of(*THREE))
    at_ns = rig.start()
    assert rig.shown(at_ns, at_ns + 10_000 * US) == [
        (0, 1), (105 * US, None), (125 * US, 2), (325 * US, 3), (625 * US, None),
    ]  # fmt: skip
    assert rig.client.read(0x1A0C) == b"\0", "it is over"


@pytest.mark.parametrize("most", [1, 2, 3, 4, 7, 0])
def test_as_many_patterns_as_were_configured(most: int) -> None:
    rig = Shower(entries_of(*THREE), most)
    at_ns = rig.start()
    shown = rig.shown(at_ns, at_ns + 5_000 * US)
    starts_us = [675 * (n // 3) + (0, 125, 325)[n % 3] for n in range(most or 23)]
    planes = [plane for plane in shown if plane[1] is not None]
    wanted = [(us * US, 1 + n % 3) for n, us in enumerate(starts_us) if us < 5_000]
    assert planes == wanted
    rig.wait(10_000)
    assert rig.client.read(0x1A0C) == (b"\0" if most else b"\2")


def test_any_stretch_of_a_long_sequence() -> None:
    """An hour without an end is not stepped through."""
    rig = Shower(entries_of(*THREE), 0)
    at_ns = rig.start()
    rig.clock.sleep_until_ns(at_ns + 3600 * 10**9)
    turns = 3600 * 10**6 // 675
    last_ns = at_ns + turns * 675 * US
    assert rig.shown(last_ns, last_ns + 400 * US) == [
        (0, 1), (105 * US, None), (125 * US, 2), (325 * US, 3),
    ]  # fmt: skip
    assert rig.shown(last_ns + 124 * US, last_ns + 126 * US) == [(0, None), (US, 2)]
    assert rig.shown(last_ns + 125 * US - 1, last_ns + 125 * US + 1) == [(0, None), (1, 2)]
    assert rig.client.read(0x1A0C) == b"\2"


def test_a_trigger_starts_it_after_its_delay() -> None:
    rig = Shower(entries_of(*THREE, wait=[0]))
    at_ns = rig.start()
    assert rig.client.read(0x1A0C) == b"\2", "it waits"
    rig.wait(5000)
    edge_ns = rig.clock.now_ns()
    rig.tick(edge_ns)
    assert rig.shown(at_ns, edge_ns + 105 * US) == [(0, None)], "black until then"
    assert rig.shown(edge_ns, edge_ns + 10_000 * US) == [
        (0, None), (105 * US, 1), (210 * US, None), (230 * US, 2), (430 * US, 3), (730 * US, None),
    ]  # fmt: skip


def test_the_delay_and_the_polarity_of_the_trigger() -> None:
    rig = Shower(entries_of(*THREE, wait=[0]))
    rig.client.write(0x1A35, struct.pack("<HB", 1000, 1))
    rig.start()
    edge_ns = rig.clock.now_ns()
    rig.tick(edge_ns, width_us=300)
    assert rig.shown(edge_ns, edge_ns + 2000 * US)[:2] == [(0, None), (1300 * US, 1)]


def test_each_round_waits_for_its_trigger() -> None:
    rig = Shower(entries_of(*THREE, wait=[0]), 0)
    rig.start()
    first_ns = rig.clock.now_ns()
    # 675 us of patterns, and a black one of 105 us before the next that waits.
    last_ns = first_ns + (105 + 675 + 105) * US
    rig.tick(first_ns)
    rig.tick(last_ns - 1)  # too soon by 1 ns
    rig.tick(last_ns + 20 * US)
    rig.tick(last_ns + 60 * US)  # while it has begun
    rig.wait(10_000)
    shown = [at for at, number in rig.shown(first_ns, rig.clock.now_ns()) if number == 1]
    assert shown == [105 * US, (105 + 675 + 105 + 20 + 105) * US]
    assert rig.device.sequencer.missed == 2
    assert rig.client.read(0x1A0C) == b"\2", "and waits again"


@pytest.mark.parametrize(("after", "rest"), [("black", []), ("holds", [(210 * US, 2)])])
def test_what_stands_after_the_last_pattern_is_an_option(
    after: str, rest: list[tuple[int, int]]
) -> None:
    options = VirtualDmdOptions(after_last=after)  # type: ignore[arg-type]
    rig = Shower(entries_of((105, 0), (105, 0)), options=options)
    at_ns = rig.start()
    rig.wait(5000)
    shown = rig.shown(at_ns, rig.clock.now_ns())
    assert shown == [(0, 1), (105 * US, 2)] + ([(210 * US, None)] if not rest else [])
    assert rig.client.read(0x1A0C) == b"\0"
    rig.client.run(STOP)
    assert rig.device.find_content() is None


@pytest.mark.parametrize("after", ["black", "holds"])
def test_what_stands_after_a_stop_is_an_option(after: str) -> None:
    options = VirtualDmdOptions(after_stop=after)  # type: ignore[arg-type]
    rig = Shower(entries_of((100_000, 0), (100_000, 0)), 0, options)
    rig.start()
    rig.wait(50_000)
    stop_ns = rig.clock.now_ns() + 10**6
    rig.client.run(STOP)
    rig.wait(300_000)
    rest = [(0, 1)] if after == "holds" else [(0, None)]
    assert rig.shown(stop_ns, rig.clock.now_ns()) == rest
    at_ns = rig.start()
    rig.wait(50_000)
    assert rig.shown(at_ns, rig.clock.now_ns()) == [(0, 1)], "anew from the first"


def test_the_crystal_of_a_device() -> None:
    """100 ppm over 27 ms are 2.7 us."""
    times = [(105, 105)] * 20
    plain = Shower(entries_of(*times), 128)
    for ppm in (100.0, -100.0):
        options = VirtualDmdOptions(timing=VirtualDmdTiming(crystal_ppm=ppm))
        rig = Shower(entries_of(*times), 128, options)
        shown = [
            [at for at, number in one.shown(at_ns, at_ns + 10**9) if number is not None]
            for one, at_ns in ((plain, plain.start()), (rig, rig.start()))
        ]
        plain.wait(100_000)
        assert len(shown[0]) == len(shown[1]) == 128
        us = 210 * np.arange(128)
        assert shown[0] == (us * US).tolist()
        wanted = us * US / (1.0 + 1e-6 * ppm)
        assert np.abs(np.array(shown[1]) - wanted).max() <= 0.5, "nothing adds up"
        assert shown[1][-1] - shown[0][-1] == pytest.approx(-ppm * 26.67, abs=1)


def test_latency_jitter_and_the_start_by_command() -> None:
    timing = VirtualDmdTiming(latency_ns=2001, start_ns=500_003)
    rig = Shower(entries_of((105, 0)), options=VirtualDmdOptions(timing=timing))
    at_ns = rig.start()
    assert rig.shown(at_ns, at_ns + 1000 * US)[:2] == [(0, None), (502_004, 1)]
    timing = VirtualDmdTiming(latency_ns=-700, jitter_ns=300, seed=5)
    rig = Shower(entries_of((105, 0), wait=[0]), 0, VirtualDmdOptions(timing=timing))
    rig.start()
    late = []
    for _ in range(200):
        rig.wait(2000)
        edge_ns = rig.clock.now_ns()
        rig.tick(edge_ns)
        late.append(rig.shown(edge_ns, edge_ns + 1000 * US)[1][0] - 105 * US)
    assert np.mean(late) == pytest.approx(-700, abs=100)
    assert np.std(late) == pytest.approx(300, rel=0.2)


def test_pulses_of_both_outputs() -> None:
    entries = [entry_bytes(n, 105, dark, 0, n, extra=n % 2) for n, dark in enumerate([20, 0, 0])]
    meanings: list[tuple[Literal[0, 1], list[int]]] = [(0, [0, 125 + 105]), (1, [125])]
    for meaning, pulsing in meanings:
        rig = Shower(entries, options=VirtualDmdOptions(trigger_2_bit=meaning))
        rig.client.write(0x1A1D, struct.pack("<Bhh", 0, 3, -5))
        rig.client.write(0x1A1E, struct.pack("<Bhh", 0, -7, 0))
        at_ns = rig.start()
        rig.wait(5000)
        now_ns = rig.clock.now_ns()
        frames = [
            (up - at_ns, down - at_ns) for up, down in rig.device.list_pulses(1, at_ns, now_ns)
        ]
        assert frames == [
            (3 * US, 100 * US), (128 * US, 225 * US), (233 * US, 330 * US),
        ]  # fmt: skip
        pulses = [(up - at_ns, down - up) for up, down in rig.device.list_pulses(2, at_ns, now_ns)]
        assert pulses == [((us - 7) * US, 20 * US) for us in pulsing]


def test_idle_mirrors_toggle_and_are_not_black() -> None:
    rig = Shower(entries_of((105, 0)))
    begun_ns = rig.clock.now_ns() + 10**6
    rig.client.write(0x0201, b"\1")
    assert rig.client.read(0x0201) == b"\1" and rig.client.read(0x1A0C) == b"\2"
    changes = rig.device.list_changes(begun_ns, begun_ns + 2100 * US)
    assert [at_ns - begun_ns for at_ns, _ in changes] == [105 * US * n for n in range(20)]
    lit = [plane is not None and bool((plane.words >> plane.bit & 1).all()) for _, plane in changes]
    assert lit == [True, False] * 10
    rig.client.run(STOP)
    assert rig.client.read(0x1A0C) == b"\2", "a stop is not what ends it"
    assert rig.client.refuses(0x1A24, bytes([START])) == 5
    rig.client.write(0x0201, b"\0")
    assert rig.client.read(0x1A0C) == b"\0" and rig.device.find_content() is None
    rig.start()


def test_changes_are_the_same_however_time_is_cut() -> None:
    rng = np.random.default_rng(7)
    times = [(int(rng.integers(105, 400)), int(rng.integers(0, 60))) for _ in range(20)]
    timing = VirtualDmdTiming(crystal_ppm=37.0, latency_ns=11)
    rig = Shower(entries_of(*times, wait=[0, 7]), 0, VirtualDmdOptions(timing=timing))
    begun_ns = rig.start()
    for _ in range(10):
        rig.wait(int(rng.integers(3000, 9000)))
        rig.tick(rig.clock.now_ns())
    end_ns = rig.clock.now_ns()
    whole = rig.shown(begun_ns, end_ns)
    cuts = [begun_ns, *sorted(rng.integers(begun_ns, end_ns, 50).tolist()), end_ns]
    parts: list[tuple[int, int | None]] = []
    for low_ns, high_ns in itertools.pairwise(cuts):
        for after_ns, number in rig.shown(low_ns, high_ns):
            if not parts or parts[-1][1] != number:
                parts.append((low_ns + after_ns - begun_ns, number))
    assert parts == whole
