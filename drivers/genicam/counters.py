"""The camera's counters: pulses at two of its inputs since the last reset."""

from __future__ import annotations

from pdcd.driver import ConfigError

from .aravis import AravisCamera

_WORDS = (
    ("CounterEventActivation", "RisingEdge"),
    ("CounterTriggerSource", "Off"),
    ("CounterResetSource", "Off"),
)
"""Settings of a counter, as far as a camera has them: it counts at once, and is only reset by
command."""


PULSES_HINT = (
    "see that camera.options.pulses names the inputs that they lead to, the projector's first"
)
"""Hint for counts that differ from the expected ones."""


class PulseCounters:
    """Two counters, one for each input. All methods raise AravisError."""

    def __init__(self, camera: AravisCamera, lines: tuple[str, str]) -> None:
        """Set up the first two. Raises ConfigError for a camera without counters, or one that
        cannot count pulses at these inputs."""
        self._camera = camera
        self._names = camera.choices("CounterSelector") if camera.has("CounterSelector") else ()
        if len(self._names) < len(lines):
            raise _refuse(f"the camera has {len(self._names)} counters", "leave it out")
        self._names = self._names[: len(lines)]
        self._begun = [0] * len(self._names)
        for name, line in zip(self._names, lines, strict=True):
            camera.set_text("CounterSelector", name)
            sources = camera.choices("CounterEventSource")
            if line not in sources:
                raise _refuse(
                    f"the camera cannot count pulses at {line}", f"take two of {', '.join(sources)}"
                )
            camera.set_text("CounterEventSource", line)
            for feature, word in _WORDS:
                if camera.has(feature):
                    camera.choose(feature, word)
            if camera.has("CounterDuration"):  # of one that stops by itself
                camera.set_integer("CounterDuration", camera.integer_bounds("CounterDuration")[1])

    def restart(self) -> None:
        """Count from 0 on."""
        for name in self._names:
            self._camera.set_text("CounterSelector", name)
            if self._camera.has("CounterReset"):
                self._camera.execute("CounterReset")
        self._begun = self._read()

    def read(self) -> tuple[int, int]:
        """Pulses since `restart`, at the first and the second input."""
        first, second = (now - then for now, then in zip(self._read(), self._begun, strict=True))
        return first, second

    def _read(self) -> list[int]:
        found = []
        for name in self._names:
            self._camera.set_text("CounterSelector", name)
            found.append(self._camera.get_integer("CounterValue"))
        return found


def _refuse(what: str, hint: str) -> ConfigError:
    return ConfigError(what, device="camera", hint=f"camera.options.pulses: {hint}")
