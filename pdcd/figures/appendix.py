"""The appendix: one primal-dual photo against many photos without a mask, in signal over noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pdcd.figures.figure import Drawn, Figure, Mode, Number, Photo, Plot, Take
from pdcd.figures.plot import colour, finish
from pdcd.sensor.appendix import EXPOSURE_S, PrintedRow, appendix_pixel, appendix_rows
from pdcd.sensor.profile import load_profile
from pdcd.sensor.snr import Pixel, Reading, masked_sum, primal_dual_photo, short_photo


def takes(mode: Mode) -> dict[str, Take]:
    """Nothing is photographed: these are formulas."""
    return {}


def drawn(mode: Mode, photos: Mapping[str, Photo]) -> Drawn:
    """Every number that the appendix prints, and what becomes of them with less light and with
    better sensors."""
    return Drawn(
        plots=(_over_time(), _over_noise()), numbers=tuple(map(number_of, appendix_rows()))
    )


def number_of(row: PrintedRow) -> Number:
    """A printed number, to be met to its last digit: rounded, or cut where the paper cut it."""
    digits = len(row.printed.partition(".")[2])
    step, printed = 10.0**-digits, float(row.printed)
    least = printed if row.truncated else printed - 0.5 * step
    most = printed + step if row.truncated else printed + 0.5 * step
    return Number(row.quantity, row.ours, least, most, paper=row.printed)


def _pixel(share: float) -> Pixel:
    """The appendix' pixel after a share of its exposure."""
    return appendix_pixel().dimmed(share)


def _over_time() -> Plot:
    mark2 = load_profile("mark2")
    quiet_e, base_e = mark2.row(1600).read_noise_e, mark2.row(50).read_noise_e
    shares = np.geomspace(0.003, 1.0, 60)
    lines: dict[str, Callable[[Pixel], Reading]] = {
        "coded photo, ISO 50": lambda p: primal_dual_photo(p, base_e, "paper"),
        "coded photo, ISO 1600": lambda p: primal_dual_photo(p, quiet_e, "paper"),
        "masked sum, ISO 50": lambda p: masked_sum(p, base_e, "paper"),
        "masked sum, ISO 1600": lambda p: masked_sum(p, quiet_e, "paper"),
        "single mask-less photo, ISO 1600": lambda p: short_photo(p, quiet_e, "paper"),
    }

    def draw(axes: Any) -> None:
        for index, (label, reading) in enumerate(lines.items()):
            ratios = [reading(_pixel(float(share))).snr_db for share in shares]
            axes.plot(EXPOSURE_S * shares, ratios, color=colour(index), label=label, lw=1.4)
        axes.axvline(EXPOSURE_S / 10.0, color="grey", lw=0.8)
        axes.set_xscale("log")
        finish(axes, "512 codes, EOS-1D Mark II", "exposure in all, s", "SNR, dB")

    return Plot(
        "time",
        draw,
        "With less time the mask-less photos fall first: each brings its own read noise. Grey: a "
        "tenth of the paper's exposure.",
    )


def _over_noise() -> Plot:
    pixel = _pixel(1.0)
    noises_e = np.geomspace(0.5, 40.0, 60)

    def draw(axes: Any) -> None:
        for index, share in enumerate((1.0, 0.1, 0.01)):
            of = pixel.dimmed(share)
            gap = [
                primal_dual_photo(of, float(e), "shot").snr_db
                - masked_sum(of, float(e), "shot").snr_db
                for e in noises_e
            ]
            label = f"{EXPOSURE_S * share:g} s"
            axes.plot(noises_e, gap, color=colour(index), label=label, lw=1.4)
        for name in ("modern", "450d", "mark2"):
            profile = load_profile(name)
            least_e = min(row.read_noise_e for row in profile.rows)
            axes.axvline(least_e, color="grey", lw=0.8)
            axes.annotate(name, (least_e, 0.98), xycoords=("data", "axes fraction"), fontsize=7,
                          rotation=90, ha="right", va="top", color="grey")  # fmt: skip
        axes.set_xscale("log")
        axes.axhline(0.0, color="black", lw=0.6)
        finish(
            axes,
            "What one coded photo gains over the masked sum",
            "read noise of a photo, electrons",
            "gain in SNR, dB",
        )

    return Plot("noise", draw, "A modern sensor makes the mask matter less; little light more.")


FIGURE = Figure(
    "appendix",
    "One coded photo against many photos without a mask",
    see=(
        "The coded photo loses no light to read noise; the sum of 512 short photos loses most "
        "where light is short."
    ),
    paper="512 codes in 30 s, and a tenth of it, at ISO 50 and 1600, of an EOS-1D Mark II.",
    unlike="",
    takes=takes,
    drawn=drawn,
)
