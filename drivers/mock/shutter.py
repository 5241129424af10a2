"""A bulb shutter with lag and jitter."""

from __future__ import annotations

import numpy as np

from pdcd.driver import Clock, DriverContext, TriggerConfig

from .bench import MockBench, check_no_options


class Lag:
    """How late the blades follow their orders: the lag and its seeded jitter."""

    def __init__(self, config: TriggerConfig, seed: int) -> None:
        self._config = config
        self._rng = np.random.default_rng([seed, 2])

    def draw_ns(self) -> int:
        """How long the next order takes, at most the lag and four jitters."""
        wobble = float(np.clip(self._rng.standard_normal(), -4.0, 4.0))
        return max(0, round((self._config.lag_s + self._config.jitter_s * wobble) * 1e9))


class MockShutter:
    """Opens and closes the bench's shutter, late by the configured lag and its seeded jitter.

    Does not model bounce, nor blades that take time to travel.
    """

    maturity = "stable"

    def __init__(self, bench: MockBench, clock: Clock, config: TriggerConfig, seed: int) -> None:
        """`config` is what is believed about the shutter; the bench knows the truth."""
        self._bench = bench
        self._clock = clock
        self._lag = Lag(bench.true.trigger, seed)
        self._sure_ns = config.sure_ns

    @classmethod
    def create(cls, context: DriverContext) -> MockShutter:
        """The shutter of this rig's bench. Raises ConfigError if it is given options."""
        config = context.config
        check_no_options(config.trigger.options, "trigger.options", "shutter")
        return cls(MockBench.of(context), context.clock, config.trigger, config.camera.seed)

    def connect(self) -> dict[str, str]:
        """Closed on return."""
        self.close()
        return {"model": "mock shutter"}

    def open(self) -> int:
        """Open within the true lag and four jitters; returns when the believed ones have passed."""
        asked_ns = self._clock.now_ns()
        self._bench.open_shutter(asked_ns + self._lag.draw_ns())
        sure_ns = asked_ns + self._sure_ns
        self._clock.sleep_until_ns(sure_ns)
        return sure_ns

    def close(self) -> int:
        """The same for closing; if it is already closed, returns the present time."""
        asked_ns = self._clock.now_ns()
        bench, fault = self._bench, self._bench.truth.trigger
        if not bench.shutter_open:
            return asked_ns
        if bench.exposures == fault.stretched and bench.open_ns is not None:
            long_ns = round(fault.stretch * (asked_ns - bench.open_ns))
            self._clock.sleep_until_ns(bench.open_ns + long_ns)
            asked_ns = self._clock.now_ns()
        bench.close_shutter(asked_ns + self._lag.draw_ns())
        sure_ns = asked_ns + self._sure_ns
        self._clock.sleep_until_ns(sure_ns)
        return sure_ns

    def disconnect(self) -> None:
        """Close."""
        self.close()
