"""Counts what a stream costs: rate, latency, errors, memory, and processor time of each process."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.capture.engine import Engine
from pdcd.protocol.stream import StreamedPicture
from tests.processes import read_rss_mib
from tests.stream_bench.recorded import find_rms

_BEFORE = 8
"""Pictures that are not counted: caches fill, and no error is measured yet."""
_LOOKS = 20


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def read_cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


@dataclass
class Meter:
    """Takes pictures until it has enough. beside : processes that are no part of the product, by
    name."""

    engine: Engine
    pictures: int
    truth: NDArray[np.floating] | None = None
    beside: dict[str, int] = field(default_factory=dict)
    count: int = 0
    over: bool = False
    latency_s: list[float] = field(default_factory=list)
    rms_sigma: list[float] = field(default_factory=list)
    errors: list[NDArray[np.floating]] = field(default_factory=list)
    sigmas: list[NDArray[np.floating]] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    spoilt: list[str] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)
    _at: list[dict[str, float]] = field(default_factory=list)

    def tell(self, streamed: StreamedPicture) -> None:
        """A picture, or a photo that was spoilt."""
        frame = streamed.frame
        if not streamed.arrays:
            self.spoilt.append(frame.spoilt)
            return
        self.count += 1
        self.kinds.append(frame.sigma_kind)
        if self.count == _BEFORE:
            self._at.append(self._now())
        if self.count <= _BEFORE or self.over:
            return
        self.latency_s.append(frame.latency_s)
        self.rms_sigma.append(frame.rms_sigma or np.nan)
        if self.truth is not None and len(self.errors) < self.pictures <= 1000:
            self.errors.append(streamed.arrays["image"] - self.truth)
            self.sigmas.append(streamed.arrays["sigma"])
        if (self.count - _BEFORE) % max(50, self.pictures // _LOOKS) == 1:
            self.memory.append((read_rss_mib(os.getpid()), read_rss_mib(self._worker)))
        if self.count == _BEFORE + self.pictures:
            self._at.append(self._now())
            self.over = True

    @property
    def _worker(self) -> int:
        return int(self.engine._worker.pid)  # type: ignore[attr-defined]

    def _now(self) -> dict[str, float]:
        used = {name: read_cpu_s(pid) for name, pid in self.beside.items()}
        own = {"rig": time.process_time(), "worker": read_cpu_s(self._worker)}
        return own | used | {"": time.monotonic()}

    def report(self) -> None:
        """Print the figures."""
        if not self.over:
            say(f"only {self.count} pictures; spoilt: {self.spoilt[-3:]}")
            return
        used = {name: at - self._at[0][name] for name, at in self._at[1].items()}
        wall_s = used.pop("")
        ms = {name: 1e3 * cpu_s / self.pictures for name, cpu_s in used.items()}
        product = ms["rig"] + ms["worker"]
        say(f"{self.pictures} pictures in {wall_s:.1f} s: {self.pictures / wall_s:.1f} a second")
        say(
            f"processor time a picture: product {product:.1f} ms (rig {ms['rig']:.1f}, worker "
            f"{ms['worker']:.1f}), {0.015 * product:.2f} of a core at 15 a second"
            + "".join(f"; {name} {ms[name]:.1f} ms" for name in self.beside)
        )
        late = 1e3 * np.array(self.latency_s)
        say(
            f"latency: median {np.median(late):.0f} ms, 95 % {np.quantile(late, 0.95):.0f} ms, "
            f"most {late.max():.0f} ms"
        )
        say(f"RMS sigma {100.0 * np.nanmedian(self.rms_sigma):.2f} %; spoilt {len(self.spoilt)}")
        if self.truth is not None and self.errors:
            error, sigma = np.array(self.errors), np.array(self.sigmas)
            known = np.isfinite(error) & np.isfinite(sigma)
            each = [find_rms(one) / find_rms(self.truth) for one in error]
            ratio = find_rms(sigma[known]) / find_rms(error[known])
            say(
                f"RMS error of a picture: median {100.0 * np.median(each):.2f} %, most "
                f"{100.0 * max(each):.2f} %; sigma over error {ratio:.2f}"
            )
        grown = ", ".join(f"{own:.0f}+{worker:.0f}" for own, worker in self.memory)
        say(f"memory of rig and worker, MiB: {grown}")
