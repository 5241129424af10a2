"""The promises of a shutter."""

from __future__ import annotations

from typing import ClassVar

import pytest

from pdcd.bench.devices import TimedShutter
from pdcd.capture.rig import Rig
from pdcd.testing.promises import Promise
from pdcd.testing.rigs import RigContract

SHUTTER_SAYS = Promise(
    "`connect` says what the shutter is: names and words",
    'return a dict of str, {"model": "..."}',
)
SHUTTER_OPEN_TIME = Promise(
    "`open` returns when it is surely open, in integer ns of the rig's clock",
    "sleep on context.clock until that time, then return it",
)
SHUTTER_CLOSE_TIME = Promise(
    "`close` returns when it is surely closed, in integer ns of the rig's clock",
    "sleep on context.clock until that time, then return it",
)
SHUTTER_CLOSE_SAFE = Promise(
    "`close` is safe in every state, twice, before `connect` and after `disconnect`",
    "return context.clock.now_ns() where nothing can be open",
)
SHUTTER_BESIDE = Promise(
    "`close` may be called beside any other call, from another thread",
    "hold no lock while a device is waited for that `close` needs too",
)
SHUTTER_DISCONNECT = Promise(
    "`disconnect` may be called twice, and `connect` after it",
    "forget the device in `disconnect`, and do nothing where there is none",
)
SHUTTER_CLOSED = Promise(
    "the shutter is closed when `connect`, `close` or `disconnect` return",
    "end the exposure in all three, whatever came before",
)
SHUTTER_OPENS = Promise(
    "the shutter is open when `open` returns, also the second time",
    "begin an exposure in each `open`",
)
SHUTTER_EXPECT = Promise(
    "`expect_exposure` moves nothing, and is about the next `open` alone",
    "keep its numbers until `open`, and forget them there",
)


class ShutterContract(RigContract):
    """Each promise of `pdcd.driver.Shutter` and `TimedShutter`, as tests of one driver.

    Nobody fetches the photos of these exposures. Where they stay in the memory of one camera for
    all tests, have it armed at the end of each, which drops what is left.
    """

    roles: ClassVar[tuple[str, ...]] = ("shutter",)

    def find_open(self, rig: Rig) -> bool | None:
        """Whether the shutter is open now; None where the device behind it cannot be asked.

        To be overridden by whoever has a fake device, or a sensor before the shutter.
        """
        return None

    def test_connect_says_what_it_is(self, rig: Rig) -> None:
        with SHUTTER_SAYS.keep():
            said = rig.shutter.connect()
        words = isinstance(said, dict) and all(
            isinstance(text, str) for pair in said.items() for text in pair
        )
        SHUTTER_SAYS.require(words, repr(said))

    def test_open_and_close_return_when_they_surely_hold(self, rig: Rig) -> None:
        for _ in range(2):
            before_ns = rig.clock.now_ns()
            with SHUTTER_OPEN_TIME.keep():
                open_ns = rig.shutter.open()
            found = f"{open_ns!r}; called at {before_ns}, returned at {rig.clock.now_ns()}"
            whole = type(open_ns) is int
            SHUTTER_OPEN_TIME.require(whole and before_ns <= open_ns <= rig.clock.now_ns(), found)
            before_ns = rig.clock.now_ns()
            with SHUTTER_CLOSE_TIME.keep():
                close_ns = rig.shutter.close()
            found = f"{close_ns!r}; called at {before_ns}, returned at {rig.clock.now_ns()}"
            whole = type(close_ns) is int
            SHUTTER_CLOSE_TIME.require(whole and before_ns <= close_ns <= rig.clock.now_ns(), found)

    def test_close_is_safe_at_any_time(self, rig: Rig) -> None:
        with SHUTTER_CLOSE_SAFE.keep():
            self.make_fresh(rig).close()
            rig.shutter.close()
            rig.shutter.open()
            first_ns = rig.shutter.close()
            second_ns = rig.shutter.close()
            SHUTTER_CLOSE_SAFE.require(second_ns >= first_ns, f"{first_ns}, then {second_ns}")
            rig.shutter.open()
            rig.shutter.disconnect()
            rig.shutter.close()

    def test_close_may_be_called_beside_another_call(self, rig: Rig) -> None:
        rig.shutter.open()
        SHUTTER_BESIDE.require_beside(rig.shutter.close)

    def test_disconnect_twice_and_connect_again(self, rig: Rig) -> None:
        with SHUTTER_DISCONNECT.keep():
            rig.shutter.disconnect()
            rig.shutter.disconnect()
            rig.shutter.connect()

    def test_it_may_be_told_how_long_the_exposure_will_be(self, rig: Rig) -> None:
        shutter = rig.shutter
        if not isinstance(shutter, TimedShutter):
            pytest.skip("it does not want to know")
        with SHUTTER_EXPECT.keep():
            shutter.expect_exposure(0.1, 30.0)
            SHUTTER_EXPECT.require(self.find_open(rig) is not True, "it is open")
            shutter.open()
            shutter.close()
            shutter.open()  # of this one nothing is known
            shutter.close()

    def test_it_is_as_open_and_closed_as_it_says(self, rig: Rig) -> None:
        if self.find_open(rig) is None:
            pytest.skip("no find_open tells whether it is open: override it to have that looked at")

        def require_closed(after: str) -> None:
            SHUTTER_CLOSED.require(not self.find_open(rig), f"open after {after}")

        require_closed("connect")
        for call in ("close", "connect", "disconnect"):
            rig.shutter.connect()
            for _ in range(2):
                rig.shutter.open()
                SHUTTER_OPENS.require(self.find_open(rig), "closed after open")
                rig.shutter.close()
                require_closed("close")
            rig.shutter.open()
            getattr(rig.shutter, call)()
            require_closed(f"open and {call}")
