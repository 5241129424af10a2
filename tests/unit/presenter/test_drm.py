"""Outputs found among a fake kernel's connectors, and its vblank counters as a time source."""

from __future__ import annotations

import errno
import os
import time
from dataclasses import replace
from itertools import pairwise

import pytest

from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter import clocks, drm, phase
from pdcd.presenter.clocks import KernelVblanks, probe
from pdcd.presenter.drm import Counter, Route, find, read_routes
from pdcd.presenter.edid import parse_edid
from pdcd.presenter.messages import Rect
from pdcd.presenter.outputs import Output
from pdcd.presenter.xpresent import KIND_MSC
from tests import fake_drm
from tests.edid_block import block
from tests.fake_drm import PERIOD_NS, Connector, Crtc, FakeKernel

CARD, OTHER = "/dev/dri/card0", "/dev/dri/card1"
EPSON, PANEL = block(serial="X4K700123", name="EPSON PJ"), block(number=77, serial="MASK-7")
PLACES = Rect(0, 0, 1024, 768), Rect(1024, 0, 1600, 1200)
LAG_NS = 3_000_000


def cards() -> dict[str, list[Connector]]:
    """One card: a free connector, the projector, and the mask 3 ms behind it."""
    return {
        CARD: [
            Connector(90, None),
            Connector(95, Crtc(41, (1024, 768)), EPSON),
            Connector(102, Crtc(45, (1600, 1200), first_ns=LAG_NS), PANEL),
        ]
    }


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> FakeKernel:
    kernel = FakeKernel(cards())
    monkeypatch.setattr(time, "monotonic_ns", lambda: kernel.now_ns)
    monkeypatch.setattr(clocks, "sleep_until", kernel.sleep_until)
    return kernel


def outputs(*, edid: bool = True, connector: bool = True) -> tuple[Output, Output]:
    """What the X server would tell of them."""
    projector = Output("HDMI-1", True, 0, 0, 1024, 768, "1024x768", 60.0)
    mask = Output("DP-3", True, 1024, 0, 1600, 1200, "1600x1200", 60.0)
    if edid:
        projector = replace(projector, edid=parse_edid(EPSON))
        mask = replace(mask, edid=parse_edid(PANEL))
    if connector:
        projector, mask = replace(projector, connector=95), replace(mask, connector=102)
    return projector, mask


def test_connectors_that_show_something_are_read(kernel: FakeKernel) -> None:
    assert read_routes(kernel, CARD) == [
        Route(CARD, 95, 41, (1024, 768), parse_edid(EPSON)),
        Route(CARD, 102, 45, (1600, 1200), parse_edid(PANEL)),
    ]
    assert kernel.open_files == 0
    # A card opened while X is away must not keep X from coming back.
    assert kernel.requests[0] == fake_drm.DROP_MASTER


@pytest.mark.parametrize(("edid", "connector"), [(True, True), (True, False), (False, True)])
def test_outputs_are_told_by_number_or_edid(
    kernel: FakeKernel, edid: bool, connector: bool
) -> None:
    found = find(outputs(edid=edid, connector=connector), kernel)
    assert [counter.route.crtc for counter in found] == [41, 45]
    assert kernel.open_files == 2
    for counter in found:
        counter.close()
        counter.close()
    assert kernel.open_files == 0


def refusal(kernel: FakeKernel, wanted: tuple[Output, Output] | None = None) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        find(wanted or outputs(), kernel)
    assert kernel.open_files == 0
    return caught.value


def test_an_output_known_by_its_name_only_is_not_guessed(kernel: FakeKernel) -> None:
    told = refusal(kernel, outputs(edid=False, connector=False))
    assert "no connector of the kernel fits the output HDMI-1" in told.message


def test_a_mode_of_another_size_does_not_fit(kernel: FakeKernel) -> None:
    projector, mask = outputs()
    told = refusal(kernel, (projector, replace(mask, width=1024, height=768)))
    assert "no connector of the kernel fits the output DP-3" in told.message


def test_number_and_edid_that_contradict_do_not_fit(kernel: FakeKernel) -> None:
    projector, mask = outputs()
    swapped = replace(projector, edid=mask.edid)
    assert "fits the output HDMI-1" in refusal(kernel, (swapped, mask)).message


def test_two_panels_alike_are_told_apart_by_number_only(kernel: FakeKernel) -> None:
    for connector in kernel.cards[CARD][1:]:
        assert connector.crtc is not None
        connector.edid, connector.crtc.size = EPSON, (1024, 768)
    first, _ = outputs()
    second = replace(first, name="HDMI-2", x=1024, connector=102)
    projector, mask = find((first, second), kernel)
    assert (projector.route.crtc, mask.route.crtc) == (41, 45)
    projector.close()
    mask.close()
    blind = replace(first, connector=None), replace(second, connector=None)
    assert "2 connectors of the kernel fit the output HDMI-1" in refusal(kernel, blind).message


def test_the_same_number_on_two_cards_is_told_by_edid(kernel: FakeKernel) -> None:
    kernel.cards[OTHER] = [Connector(95, Crtc(41, (1024, 768)), block(serial="OTHER"))]
    found = find(outputs(), kernel)
    assert found[0].route.node == CARD
    for counter in found:
        counter.close()
    told = refusal(kernel, outputs(edid=False))
    assert "2 connectors of the kernel fit the output HDMI-1" in told.message


def test_panels_cloned_from_one_crtc_are_refused(kernel: FakeKernel) -> None:
    _, projector, mask = kernel.cards[CARD]
    mask.crtc = projector.crtc
    first, second = outputs()
    cloned = replace(second, width=1024, height=768)
    assert "both panels are fed by one CRTC" in refusal(kernel, (first, cloned)).message


def test_no_card(kernel: FakeKernel) -> None:
    kernel.cards.clear()
    assert "the kernel drives no graphics card" in refusal(kernel).message


def test_a_card_that_may_not_be_opened_names_the_group(kernel: FakeKernel) -> None:
    kernel.failures[CARD] = errno.EACCES
    told = refusal(kernel)
    assert told.message.endswith(f"{CARD}: Permission denied")
    assert told.hint == drm.PERMISSION_HINT and "video" in drm.PERMISSION_HINT


def test_a_card_without_displays_beside_the_right_one_does_no_harm(kernel: FakeKernel) -> None:
    kernel.cards[OTHER] = []
    kernel.failures[OTHER] = errno.EACCES
    for counter in find(outputs(), kernel):
        counter.close()


REQUESTS = [
    fake_drm.GET_RESOURCES, fake_drm.GET_CONNECTOR, fake_drm.GET_ENCODER, fake_drm.GET_CRTC,
    fake_drm.GET_PROPERTY, fake_drm.GET_BLOB, fake_drm.GET_SEQUENCE,
]  # fmt: skip


@pytest.mark.parametrize("number", [errno.EACCES, errno.EINVAL, errno.EOPNOTSUPP, errno.ENODEV])
@pytest.mark.parametrize("request_", REQUESTS)
def test_every_call_may_fail(kernel: FakeKernel, request_: int, number: int) -> None:
    kernel.failures[request_] = number
    told = refusal(kernel)
    assert told.hint and told.message.startswith("no vblank counter: ")
    assert os.strerror(number) in told.message


def test_a_connector_that_has_just_gone_is_left_out(kernel: FakeKernel) -> None:
    kernel.failures[fake_drm.GET_ENCODER] = errno.ENOENT
    assert read_routes(kernel, CARD) == []


def test_a_crtc_that_is_switched_off_counts_nothing(kernel: FakeKernel) -> None:
    found = read_routes(kernel, CARD)[0]
    crtc = kernel.cards[CARD][1].crtc
    assert crtc is not None
    crtc.active = False
    with pytest.raises(ConfigError, match="CRTC 41 is switched off"):
        Counter(kernel, found)
    assert kernel.open_files == 0
    assert "fits the output HDMI-1" in refusal(kernel).message


def test_both_panels_are_counted_or_none(kernel: FakeKernel) -> None:
    crtc = kernel.cards[CARD][2].crtc
    assert crtc is not None
    crtc.uncounted = True
    told = refusal(kernel).message
    assert told.endswith(f"{CARD}, CRTC 45 counts no vblanks: Operation not supported")


def test_each_vblank_has_its_number_and_its_time(kernel: FakeKernel) -> None:
    _, counter = find(outputs(), kernel)
    counter.ask(0)
    assert counter.wait(KIND_MSC, 0.5)
    first = counter.msc
    for number in range(first + 2, first + 12, 3):
        counter.ask(number)
        assert counter.wait(KIND_MSC, 0.5)
        assert (counter.msc, counter.ns) == (number, LAG_NS + round(number * PERIOD_NS))


def test_a_counter_older_than_two_days_still_answers_at_once(kernel: FakeKernel) -> None:
    kernel.now_ns += (fake_drm.PASSED + 99) * PERIOD_NS
    counter, _ = find(outputs(), kernel)
    before_ns = kernel.now_ns
    counter.ask(0)
    assert counter.wait(KIND_MSC, 0.5) and kernel.now_ns == before_ns


def test_events_given_up_before_and_strange_ones_are_passed_over(kernel: FakeKernel) -> None:
    counter, _ = find(outputs(), kernel)
    counter.ask(0)
    assert counter.wait(KIND_MSC, 0.5)
    msc = counter.msc
    counter.ask(msc + 60)
    assert not counter.wait(KIND_MSC, 0.1)
    counter.ask(msc + 62)
    # A page flip's event, a broken one without a length, half a header.
    kernel.stale = [b"\2\0\0\0\x20\0\0\0" + bytes(24), bytes(8), b"\3\0\0"]
    assert counter.wait(KIND_MSC, 2.0) and counter.msc == msc + 62
    counter.ask(msc + 600)
    begun_ns = kernel.now_ns
    assert not counter.wait(KIND_MSC, 0.5)
    assert kernel.now_ns - begun_ns == 500_000_000


def test_a_card_that_goes_away_is_lost(kernel: FakeKernel, monkeypatch: pytest.MonkeyPatch) -> None:
    counter, _ = find(outputs(), kernel)
    kernel.failures[fake_drm.QUEUE_SEQUENCE] = errno.EINVAL
    with pytest.raises(DeviceLost, match=r"CRTC 41: Invalid argument"):
        counter.ask(0)

    def gone(fd: int, timeout_s: float) -> bytes:
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr(kernel, "read", gone)
    with pytest.raises(DeviceLost, match=r"CRTC 41: No such device"):
        counter.wait(KIND_MSC, 0.5)


class Swaps:
    """Notes when swaps were made, and how long drawing takes."""

    def __init__(self, kernel: FakeKernel) -> None:
        self._kernel = kernel
        self.ns: list[int] = []
        self.draw_ns = 2_000_000

    def swap(self) -> None:
        self.ns.append(self._kernel.now_ns)

    def draw(self) -> None:
        self._kernel.now_ns += self.draw_ns


def source_on(kernel: FakeKernel, period_ns: float = PERIOD_NS) -> tuple[KernelVblanks, Swaps]:
    _, counter = find(outputs(), kernel)
    crtc = kernel.cards[CARD][2].crtc
    assert crtc is not None
    crtc.period_ns = period_ns
    swaps = Swaps(kernel)
    return KernelVblanks(counter, swaps.swap, lambda: None, float(PERIOD_NS)), swaps


def test_a_counter_that_delivers_is_believed(kernel: FakeKernel) -> None:
    source, swaps = source_on(kernel, 1.001 * PERIOD_NS)
    found = probe(source, swaps.draw, float(PERIOD_NS))
    assert found == pytest.approx(1.001 * PERIOD_NS, rel=1e-6)
    assert len(swaps.ns) == clocks.WARM_UP_FRAMES
    # Each swap comes with its vblank: at the interrupt, ahead of the first pixel.
    assert swaps.ns[-1] == source.ns - fake_drm.LEAD_NS
    assert (source.name, source.flipped) == ("drm", 0)


@pytest.mark.parametrize("rate", [0.5, 0.97, 1.03, 2.0])
def test_a_counter_of_another_rate_is_not_believed(kernel: FakeKernel, rate: float) -> None:
    source, swaps = source_on(kernel, PERIOD_NS / rate)
    assert probe(source, swaps.draw, float(PERIOD_NS)) is None


def test_a_counter_that_stands_still_is_not_believed(kernel: FakeKernel) -> None:
    source, swaps = source_on(kernel)
    crtc = kernel.cards[CARD][2].crtc
    assert crtc is not None
    crtc.stuck = True
    assert probe(source, swaps.draw, float(PERIOD_NS)) is None


def test_a_counter_that_fails_is_not_believed(kernel: FakeKernel) -> None:
    source, swaps = source_on(kernel)
    kernel.failures[fake_drm.QUEUE_SEQUENCE] = errno.EOPNOTSUPP
    assert probe(source, swaps.draw, float(PERIOD_NS)) is None


@pytest.mark.parametrize("held_up", [0.1, 0.9, 1.3, 2.6, 7.7])
def test_each_delay_costs_the_refreshes_that_passed(kernel: FakeKernel, held_up: float) -> None:
    source, swaps = source_on(kernel)
    source.sync()
    for _ in range(3):
        source.put()
        source.shown()
    before, at_ns = source.msc, source.ns
    kernel.now_ns += round(held_up * PERIOD_NS)
    source.put()
    source.shown()
    # The interrupt of a vblank leads its stamp by a fortieth of a refresh; a quarter is forgiven.
    assert source.msc - before == max(1, -int(-(held_up - 0.25 - 0.024) // 1))
    assert source.ns - at_ns == (source.msc - before) * PERIOD_NS
    assert all(later > sooner for sooner, later in pairwise(swaps.ns))


def test_the_phase_is_that_of_both_counters(kernel: FakeKernel) -> None:
    counters = find(outputs(), kernel)
    # No X server is asked: there is none of this name.
    found = phase.measure(":nowhere", PLACES, counters)
    assert found is not None
    assert found.lag_s == pytest.approx(LAG_NS * 1e-9, abs=1e-8)
    assert found.period_s == pytest.approx((PERIOD_NS * 1e-9,) * 2, rel=1e-9)


def test_without_the_counters_the_server_is_asked_for_the_phase(
    kernel: FakeKernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(phase, "_sample_windows", lambda name, panels: asked.append(name))
    counters = find(outputs(), kernel)
    kernel.failures[fake_drm.QUEUE_SEQUENCE] = errno.EINVAL
    assert phase.measure(":7", PLACES, counters) is None
    kernel.failures.clear()
    crtc = kernel.cards[CARD][2].crtc
    assert crtc is not None
    crtc.stuck = True
    assert phase.measure(":7", PLACES, counters) is None
    assert phase.measure(":7", PLACES) is None
    assert asked == [":7"] * 3
