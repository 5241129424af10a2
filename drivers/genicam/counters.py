"""The camera's counters: pulses at two of its inputs since they were set back."""

from __future__ import annotations

from pdcd.driver import ConfigError

from .aravis import AravisCamera

_WORDS = (
    ("CounterEventActivation", "RisingEdge"),
    ("CounterTriggerSource", "Off"),
    ("CounterResetSource", "Off"),
)
"""How a counter is set, as far as a camera has it: it counts at once, and is set back by command
alone."""


class PulseCounters:
    """Two counters, one for each input. All methods raise AravisError."""

    def __init__(self, camera: AravisCamera, lines: tuple[str, str]) -> None:
        """Set up the first two. Raises ConfigError for a camera that has none, or cannot count
        what comes to these inputs."""
        self._camera = camera
        self._names = camera.choices("CounterSelector") if camera.has("CounterSelector") else ()
        if len(self._names) < len(lines):
            raise _refuse(f"the camera has {len(self._names)} counters", "leave it out")
        self._names = self._names[: len(lines)]
        self._begun = [0, 0]
        for name, line in zip(self._names, lines, strict=True):
            camera.set_text("CounterSelector", name)
            sources = camera.choices("CounterEventSource")
            if line not in sources:
                raise _refuse(
                    f"the camera cannot count pulses at {line}", f"take two of {', '.join(sources)}"
                )
            camera.set_text("CounterEventSource", line)
            for feature, word in _WORDS:
                if camera.has(feature) and word in camera.choices(feature):
                    camera.set_text(feature, word)
            if camera.has("CounterDuration"):  # of one that stops by itself
                camera.set_integer("CounterDuration", camera.integer_bounds("CounterDuration")[1])

    def restart(self) -> None:
        """Count from 0 on."""
        for number, name in enumerate(self._names):
            self._camera.set_text("CounterSelector", name)
            if self._camera.has("CounterReset"):
                self._camera.execute("CounterReset")
            self._begun[number] = self._camera.get_integer("CounterValue")

    def read(self) -> tuple[int, int]:
        """Pulses since then, at the first and the second input."""
        found = [0, 0]
        for number, name in enumerate(self._names):
            self._camera.set_text("CounterSelector", name)
            found[number] = self._camera.get_integer("CounterValue") - self._begun[number]
        return found[0], found[1]


def _refuse(what: str, hint: str) -> ConfigError:
    return ConfigError(what, device="camera", hint=f"camera.options.pulses: {hint}")
