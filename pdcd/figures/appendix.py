"""The appendix: one primal-dual photo against many photos without a mask, in signal over noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePlot,
    FigureTake,
    Line,
    PaperFigure,
    Photos,
)
from pdcd.sensor.appendix import EXPOSURE_S, PrintedRow, compute_appendix_rows, make_appendix_pixel
from pdcd.sensor.profile import load_profile
from pdcd.sensor.snr import (
    SnrPixel,
    SnrReading,
    compute_masked_sum,
    compute_primal_dual_photo,
    compute_short_photo,
)


def takes(mode: FigureMode) -> dict[str, FigureTake]:
    """No captures: these are formulas."""
    return {}


def shown(mode: FigureMode, photos: Photos) -> Iterator[FigurePlot | BoundedNumber]:
    """Every number that the appendix prints, and the same with less light and with better
    sensors."""
    yield _over_time()
    yield _over_noise()
    yield from map(_number_of, compute_appendix_rows())


def _number_of(row: PrintedRow) -> BoundedNumber:
    """A printed number, which ours must equal to its last digit: rounded, or cut where the paper
    cut it."""
    digits = len(row.printed.partition(".")[2])
    step, printed = 10.0**-digits, float(row.printed)
    least = printed if row.truncated else printed - 0.5 * step
    most = printed + step if row.truncated else printed + 0.5 * step
    return BoundedNumber(row.quantity, row.ours, least, most, paper=row.printed)


def _over_time() -> FigurePlot:
    mark2 = load_profile("mark2")
    quiet_e, base_e = mark2.row(1600).read_noise_e, mark2.row(50).read_noise_e
    shares = np.geomspace(0.003, 1.0, 60)
    pixels = [make_appendix_pixel().dimmed(float(share)) for share in shares]
    readings: dict[str, Callable[[SnrPixel], SnrReading]] = {
        "coded photo, ISO 50": lambda p: compute_primal_dual_photo(p, base_e, "paper"),
        "coded photo, ISO 1600": lambda p: compute_primal_dual_photo(p, quiet_e, "paper"),
        "masked sum, ISO 50": lambda p: compute_masked_sum(p, base_e, "paper"),
        "masked sum, ISO 1600": lambda p: compute_masked_sum(p, quiet_e, "paper"),
        "single mask-less photo, ISO 1600": lambda p: compute_short_photo(p, quiet_e, "paper"),
    }
    return FigurePlot(
        "time",
        "512 codes, EOS-1D Mark II",
        "exposure in all, s",
        "SNR, dB",
        "With less time the mask-less photos fall first: each brings its own read noise. Grey: a "
        "tenth of the paper's exposure.",
        tuple(
            Line(EXPOSURE_S * shares, [reading(p).snr_db for p in pixels], label, colour=index)
            for index, (label, reading) in enumerate(readings.items())
        ),
        scales=("log", "linear"),
        marks=((EXPOSURE_S / 10.0, ""),),
    )


def _over_noise() -> FigurePlot:
    noises_e = np.geomspace(0.5, 40.0, 60)
    lines, marks = [], []
    for index, share in enumerate((1.0, 0.1, 0.01)):
        pixel = make_appendix_pixel().dimmed(share)
        gain_db = [
            compute_primal_dual_photo(pixel, float(e), "shot").snr_db
            - compute_masked_sum(pixel, float(e), "shot").snr_db
            for e in noises_e
        ]
        lines.append(Line(noises_e, gain_db, f"{EXPOSURE_S * share:g} s", colour=index))
    for name in ("modern", "450d", "mark2"):
        marks.append((min(row.read_noise_e for row in load_profile(name).rows), name))
    return FigurePlot(
        "noise",
        "What one coded photo gains over the masked sum",
        "read noise of a photo, electrons",
        "gain in SNR, dB",
        "A modern sensor makes the mask matter less; little light more.",
        tuple(lines),
        scales=("log", "linear"),
        marks=tuple(marks),
        level=0.0,
    )


FIGURE = PaperFigure(
    "appendix",
    "One coded photo against many photos without a mask",
    see=(
        "The coded photo loses no light to read noise; the sum of 512 short photos loses most "
        "where light is short."
    ),
    paper="512 codes in 30 s, and a tenth of it, at ISO 50 and 1600, of an EOS-1D Mark II.",
    unlike="",
    takes=takes,
    shown=shown,
)
