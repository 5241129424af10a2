"""The camera's sensor, measured at one ISO: black, gain, read noise, saturation, linearity.

The photos are two of black panels, one of the open mask alone, and white light of counted refreshes
from 3 to 130 % of the saturating dose, two doses twice. The shutter is open equally long in all of
them. Anything that does not move may stand in front of the camera: a card is best, because its
light is even.

RAW samples are used plane by plane, R, G1, G2, B or grey, as the sensor gave them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.reading import format_toml
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.photo import BLACK_MOVES_DN, average_blocks, check_brightness
from pdcd.calibration.sensor.dose import DoseLine, fit_dose_line
from pdcd.calibration.sensor.transfer import (
    VARIANCE_BLOCK_SIDE,
    PhotonTransfer,
    average_block_parts,
    compare_plane_pair,
    fit_photon_transfer,
    split_blocks,
)
from pdcd.calibration.shown import NO_PATTERNS, PanelSequence
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK, WHITE
from pdcd.sensor.profile import IsoRow, SensorProfile

_Planes = NDArray[np.float32]

_NAMES = {4: ("R", "G1", "G2", "B"), 1: ("grey",)}
_LADDER = (0.03, 0.06, 0.12, 0.2, 0.4, 0.6, 0.75, 0.9, 1.1, 1.3)
_TWICE = (0.2, 0.6)
"""Shares of the saturating dose; and the shares that are photographed twice, for photon
transfer."""
_LEAST_REFRESHES = 2
"""Least refreshes of a dose: a single refresh ends before the panel has risen."""
_TRANSFER_SHARE = 0.7
_BRIGHT, _ALIKE = 0.98, 0.03
"""Blocks within 3 % of the 98th percentile of light represent their plane in the doses."""
_LIT = 0.3
"""Light of the darkest part of a block, over the brightest of all, from which the block is lit."""
_EVEN = 0.1
"""Largest relative difference of light within a block that lenses and lamps make; where a scene has
no such blocks, the most even quarter is used."""
_ROUNDING_DN = 0.29
_DARK_LIMIT_DN = 30.0
"""Largest light of dark photos above their black level; panels leak a tenth of that."""
_LEAKED_DN = 1.5
_HOT_SIGMAS = 5.0
_ROOM_SHARE = 0.2
"""Largest light without a dose, over saturation."""
_FLAT_LIMIT = 0.01
_LAMP_LIMIT = 0.01


@dataclass(frozen=True)
class SensorPlan:
    """What to show.

    full : white refreshes that just saturate the brightest quads at the f-number in use; at least
        67, so that the smallest dose has two.
    lead : refreshes for which the mask is open before and after the light.
    """

    full: int
    lead: int = 6

    def __post_init__(self) -> None:
        if round(min(_LADDER) * self.full) < _LEAST_REFRESHES:
            raise CalibrationError(
                f"{self.full} refreshes saturate the camera: too few to be counted",
                device="camera",
                hint="close the aperture until it takes 67 refreshes or more",
            )

    @property
    def doses(self) -> dict[str, int]:
        """White refreshes of each photo with light, by its name."""
        found = {}
        for share in _LADDER:
            count = round(share * self.full)
            found[f"dose-{count}"] = count
            if share in _TWICE:
                found[f"dose-{count}-again"] = count
        return found

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of the photos that were taken twice."""
        names = [f"dose-{round(share * self.full)}" for share in _TWICE]
        return tuple((name, f"{name}-again") for name in names)

    @property
    def refreshes(self) -> int:
        """Refreshes of every photo."""
        return max(self.doses.values()) + 2 * self.lead

    def photos(self) -> tuple[PanelSequence, ...]:
        """The series, in the order in which to take it."""
        closed, opened = (np.full(self.refreshes, index, np.int32) for index in (BLACK, WHITE))
        none = NO_PATTERNS
        shown = [PanelSequence(f"dark-{which}", none, none, closed, closed) for which in "ab"]
        shown.append(PanelSequence("base", none, none, closed, opened))
        for name, count in self.doses.items():
            light = closed.copy()
            light[self.lead : self.lead + count] = WHITE
            shown.append(PanelSequence(name, none, none, light, opened))
        return tuple(shown)


@dataclass(frozen=True, eq=False)
class SensorMeasurement:
    """What was measured at one ISO, plane by plane (R, G1, G2, B, or grey).

    black_dn : (P,) float64, black level of the file; black_sigma : its change from photo to photo.
    transfer, lines : gain and noise, linearity and saturation.
    lamp : largest relative difference of photos that should be equal.
    """

    iso: int
    black_dn: Floats
    black_sigma: float
    transfer: tuple[PhotonTransfer, ...]
    lines: tuple[DoseLine, ...]
    lamp: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the planes."""
        return _NAMES[len(self.lines)]

    @property
    def gain(self) -> tuple[float, float]:
        """e- per DN and its standard deviation, of all planes."""
        return _mean([(t.gain_e_per_dn, t.gain_sigma) for t in self.transfer])

    @property
    def read_noise(self) -> tuple[float, float]:
        """e- and standard deviation, of all planes."""
        return _mean([(t.read_noise_e, t.read_sigma) for t in self.transfer])

    @property
    def saturation_dn(self) -> float | None:
        """Lowest of the planes that saturated; None where none did."""
        return min(
            (s for line in self.lines if (s := line.saturation_dn) is not None), default=None
        )

    @property
    def offset_refreshes(self) -> tuple[float, float]:
        """What the projector's edges add to any dose, (fall - rise) / refresh, and its standard
        deviation. The planes share the lamp's errors, so averaging them does not reduce the
        error."""
        values, sigmas = zip(
            *((n.offset_refreshes, n.offset_sigma) for n in self.lines), strict=True
        )
        return float(np.mean(values)), float(np.mean(sigmas))

    def figures(self) -> tuple[MeasuredFigure, ...]:
        """The figures of the sensor."""
        good, doubtful, bad = Verdict.GOOD, Verdict.DOUBTFUL, Verdict.BAD
        gains = [t.gain_e_per_dn for t in self.transfer]
        alike = good if max(gains) < 1.05 * min(gains) else doubtful
        told = doubtful if any(t.rounded for t in self.transfer) else good
        full, limit, reached = self.saturation_dn, "reached", good
        if full is None:
            full, reached = max(n.highest_dn for n in self.lines), doubtful
            limit = "at least this: no dose reached it"
        error = max(line.error for line in self.lines)
        bent = bad if self.lamp <= _LAMP_LIMIT else doubtful
        flat = f"{_FLAT_LIMIT:g}, lamp within {_LAMP_LIMIT:g}"
        return (
            MeasuredFigure("sensor.black_dn", float(self.black_dn.mean()), self.black_sigma, "DN"),
            MeasuredFigure("sensor.gain_e_per_dn", *self.gain, "e-/DN", "planes within 5 %", alike),
            MeasuredFigure("sensor.read_noise_e", *self.read_noise, "e-", "not hidden by rounding",
            told),
            MeasuredFigure("sensor.saturation_dn", full, _ROUNDING_DN, "DN", limit, reached),
            MeasuredFigure(
                "sensor.linearity", error, self.lamp, "", flat,
                good if error <= _FLAT_LIMIT else bent,
            ),
        )  # fmt: skip


def measure_sensor(
    photos: Mapping[str, _Planes],
    plan: SensorPlan,
    *,
    iso: int,
    black_dn: Floats,
    dark_e: float = 0.0,
    masked: bool = False,
) -> SensorMeasurement:
    """Black, gain, read noise, saturation and linearity from a series.

    Parameters
    ----------
    photos : name -> (P, h, w) float32, R, G1, G2, B or grey in DN minus black, by the names of
        `plan.photos()`. Each is asked for at most three times, so that it may be read from a file.
    plan : what was shown.
    iso : at which it was taken.
    black_dn : (P,) what was subtracted: the mean of the masked border, or the file's number.
    dark_e : electrons of dark current in a dark photo; their noise, and that of light that the
        panels leak, is subtracted from the read noise.
    masked : whether `black_dn` is from the masked border. A number of the file may itself be wrong,
        so that then no more than `_LEAKED_DN` above it counts as light.

    Raises CalibrationError: no light, a shutter that did not open, light in dark photos, a black
    level that moves, saturated or dim flats, something that moved, samples that were filtered.
    """
    dark, again, base = (photos[name] for name in ("dark-a", "dark-b", "base"))
    shift, black_sigma = _refuse_dark_light(dark, again)
    lines, signal = _lines(photos, plan, base, dark)
    leaked = np.clip(shift, 0.0, _DARK_LIMIT_DN if masked else _LEAKED_DN)
    lit = [(photos[one], photos[other]) for one, other in plan.pairs]
    found = []
    for plane, line in enumerate(lines):
        found.append(
            fit_photon_transfer(
                _NAMES[len(lines)][plane],
                compare_plane_pair(dark[plane], again[plane]),
                tuple(
                    compare_plane_pair(one[plane], other[plane], dark[plane]) for one, other in lit
                ),
                highest_dn=_TRANSFER_SHARE * line.highest_dn,
                dark_e=dark_e,
                leaked_dn=float(leaked[plane]),
            )
        )
    names = list(plan.doses)
    level = _pick_main_plane(signal)
    lamp = max(
        abs(float(level[names.index(b)] / level[names.index(a)]) - 1.0) for a, b in plan.pairs
    )
    black = np.asarray(black_dn, np.float64) + shift
    return SensorMeasurement(iso, black, black_sigma, tuple(found), lines, lamp)


def _lines(
    photos: Mapping[str, _Planes], plan: SensorPlan, base: _Planes, dark: _Planes
) -> tuple[tuple[DoseLine, ...], Floats]:
    """The dose line of each plane, from its brightest evenly lit blocks, and their light, (P,
    doses)."""
    floor = _levels(base)
    first = photos[plan.pairs[0][0]]
    light = _levels(first) - floor
    planes = range(len(base))
    chosen = np.stack(
        [_brightest(light[plane], _evenly_lit(first[plane] - base[plane])) for plane in planes]
    )
    signal = np.empty((len(base), len(plan.doses)))
    for number, name in enumerate(plan.doses):
        level = _levels(photos[name]) - floor
        signal[:, number] = [level[plane][chosen[plane]].mean() for plane in planes]
    _refuse_no_light(plan, signal, dark)
    doses = np.array(list(plan.doses.values()), np.float64)
    order = np.argsort(doses, kind="stable")
    most = photos[max(plan.doses, key=lambda name: plan.doses[name])]
    full, noise = _levels(most), _spreads(most)
    lines = tuple(
        fit_dose_line(
            name,
            doses[order],
            signal[plane, order],
            # Where the sensor saturates, a few blocks may not: the median block decides.
            *(float(np.median(of[plane][chosen[plane]])) for of in (full, floor, noise)),
        )
        for plane, name in enumerate(_NAMES[len(base)])
    )
    _refuse_room(base, lines)
    return lines, signal


def _brightest(light: Floats, even: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The brightest of the evenly lit blocks; all where there is no light."""
    found = even & (light >= (1.0 - _ALIKE) * np.quantile(light[even], _BRIGHT))
    return found if found.any() else np.ones_like(even)


def _evenly_lit(light: _Planes) -> NDArray[np.bool_]:
    """Evenly lit blocks: in others, as at the edge of the light, the brighter part saturates first.
    All blocks where there is hardly any light."""
    parts = average_block_parts(light.astype(np.float64))
    least, most = parts.min(axis=(1, 3)), parts.max(axis=(1, 3))
    lit = least > _LIT * float(np.quantile(most, _BRIGHT))
    if not lit.any():
        return np.ones(lit.shape, np.bool_)
    apart = 1.0 - least / np.where(lit, most, 1.0)
    return np.asarray(lit & (apart <= max(_EVEN, float(np.quantile(apart[lit], 0.25)))))


def _levels(planes: _Planes) -> Floats:
    """Means of blocks, (P, rows, cols) float64."""
    return np.stack(
        [average_blocks(plane.astype(np.float64), VARIANCE_BLOCK_SIDE) for plane in planes]
    )


def _spreads(planes: _Planes) -> Floats:
    """Standard deviation within blocks, hot samples left out, (P, rows, cols) float64."""
    found = []
    for plane in planes.astype(np.float64):
        low, high = np.quantile(split_blocks(plane), (0.16, 0.84), axis=(1, 3))
        found.append(0.5 * (high - low))
    return np.stack(found)


def _refuse_dark_light(dark: _Planes, again: _Planes) -> tuple[Floats, float]:
    """How far the dark photos lie from the black that was subtracted, (P,) DN, and the standard
    deviation of one photo's black level, from their difference. Raises CalibrationError where
    either is too large."""
    levels = [np.array([_middle(plane) for plane in planes]) for planes in (dark, again)]
    apart = float(np.abs(levels[0] - levels[1]).max())
    shift = np.asarray(0.5 * (levels[0] + levels[1]), np.float64)
    if float(np.abs(shift).max()) > _DARK_LIMIT_DN:
        raise CalibrationError(
            f"dark photos lie {float(np.abs(shift).max()):.3g} DN above black: light comes in",
            device="mask",
            hint="darken the room; see that both panels are black and that the mask's polarisers "
            "are crossed",
        )
    if apart > BLACK_MOVES_DN:  # much light would move it, too
        raise CalibrationError(
            f"the black level moves: two dark photos differ by {apart:.2g} DN",
            device="camera",
            hint="let the camera warm up for ten minutes; switch long-exposure noise reduction "
            "off; keep the room dark",
        )
    return shift, apart / np.sqrt(2.0)


def _middle(plane: NDArray[np.float32]) -> float:
    """Mean of the samples of a dark plane, hot ones left out."""
    low, middle, high = np.quantile(plane, (0.16, 0.5, 0.84))
    kept = np.abs(plane - middle) <= _HOT_SIGMAS * max(0.5 * float(high - low), 1.0)
    return float(np.mean(plane[kept], dtype=np.float64))


def _pick_main_plane(planes: NDArray[np.floating]) -> NDArray[np.floating]:
    """The plane of G1, or of grey."""
    return np.asarray(planes[(len(planes) - 1) // 2])


def _refuse_no_light(plan: SensorPlan, signal: Floats, dark: _Planes) -> None:
    """Raise CalibrationError where all photos, or one of them, show no light."""
    spread = float(np.std(_pick_main_plane(dark)))
    floor = max(0.05 * spread, 1.0)
    check_brightness({name: float(signal[:, n].max()) for n, name in enumerate(plan.doses)}, floor)


def _refuse_room(base: _Planes, lines: tuple[DoseLine, ...]) -> None:
    """Raise CalibrationError where there is much light without the projector."""
    for plane, line in enumerate(lines):
        share = float(np.median(base[plane])) / line.highest_dn
        if share > _ROOM_SHARE:
            raise CalibrationError(
                f"without the projector, plane {_NAMES[len(lines)][plane]} is at "
                f"{100.0 * share:.0f} % of "
                "saturation",
                device="camera",
                hint="switch the room lights off",
            )


def _mean(values: list[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean and its standard deviation."""
    found = np.array(values)
    weights = 1.0 / np.maximum(found[:, 1], 1e-12) ** 2
    return float(weights @ found[:, 0] / weights.sum()), float(weights.sum() ** -0.5)


def make_measured_profile(
    body: SensorMeasurement,
    known: SensorProfile,
    *,
    name: str,
    description: str,
    source: str,
    base: str = "",
) -> SensorProfile:
    """The profile of this very body: a known profile with what was measured at its ISO.

    known : gives what was not measured: dark current, bits, size; white level and full well where
        the series did not reach them. Its rows of other ISOs are kept only where it is itself a
        measured profile.
    base : what `known` was read from, where it is not a measured profile.

    Raises ConfigError where the numbers make no valid profile.
    """
    gain, read = body.gain[0], body.read_noise[0]
    black = round(float(body.black_dn.mean()))
    stop = body.saturation_dn
    white, full = known.white_dn, known.full_well_e
    if stop is not None and all(line.clipped for line in body.lines if line.saturation_dn):
        white, full = round(black + stop), max(full, stop * gain)
    elif stop is not None:
        full = stop * gain
    others = () if known.estimated else tuple(row for row in known.rows if row.iso != body.iso)
    rows = (*others, IsoRow(body.iso, float(f"{gain:.6g}"), float(f"{read:.6g}")))
    return SensorProfile(
        name=name,
        description=description,
        source=source,
        estimated=False,
        bits=known.bits,
        black_dn=black,
        white_dn=white,
        full_well_e=float(f"{full:.6g}"),
        dark_e_per_s=known.dark_e_per_s,
        rows=tuple(sorted(rows, key=lambda row: row.iso)),
        frame_quads=known.frame_quads,
        base=known.base or base,
        mono=True if len(body.lines) == 1 else msgspec.UNSET,
    )


def format_profile(profile: SensorProfile) -> str:
    """A profile as the TOML file that `pdcd.sensor.profile.load_profile` reads."""
    table = msgspec.to_builtins(profile)
    return f"# {profile.description}\n" + format_toml(table)
