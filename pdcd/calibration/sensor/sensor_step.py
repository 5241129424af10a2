"""The camera's sensor at one ISO: black, gain, read noise, saturation, linearity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.figures import Verdict
from pdcd.calibration.light.metering import FULL_SHARE, LEAST, choose_wide_aperture
from pdcd.calibration.photo import RawSettings, check_camera_settings
from pdcd.calibration.preview import PLOT_CHANNELS, PLOT_GREY, label_plot
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    ConfigValue,
    PhotoRequest,
    StepOutcome,
    StepScript,
    take_photo,
)
from pdcd.calibration.sensor.body import (
    SensorMeasurement,
    SensorPlan,
    make_measured_profile,
    measure_sensor,
)
from pdcd.sensor.raw import RawFrame

_Planes = NDArray[np.float32]

_SATURATING = 120
"""White refreshes that should saturate: the smallest dose is then four, and a photo takes 3 s."""
_PROFILE = "sensor.toml"
"""File of the profile in the calibration's folder."""
EDGE_KEY = "sensor.edge_s"
"""Array (2,): what the projector's edges add to any time of white, fall - rise, and its sigma."""
GAIN_KEY = "sensor.gain_e_per_dn"
"""Array (2,): the gain and its sigma."""
BLACK_SIGMA_KEY = "sensor.black_sigma_dn"
"""Array (1,): standard deviation of the black level from photo to photo."""


def calibrate_sensor(session: CalibrationSession) -> StepScript:
    """Photos of black, and of white light of counted refreshes until the sensor saturates.

    The resulting profile replaces the camera's.
    """
    f_number, full = choose_wide_aperture(session, round(FULL_SHARE * _SATURATING))
    plan = SensorPlan(round(full / FULL_SHARE))
    film = Film()
    seen: dict[str, RawSettings] = {}
    open_s: dict[str, float] = {}
    for shown in plan.photos():
        taken = yield from take_photo(PhotoRequest(shown, f_number=f_number, counted=True))
        film.keep(taken)
        seen[shown.name], open_s[shown.name] = taken.seen, taken.open_s
    check_camera_settings(seen, iso=session.iso, f_number=f_number, open_s=open_s)
    known, iso = session.profile, session.iso
    body = measure_sensor(
        film,
        plan,
        iso=iso,
        black_dn=film.black_dn,
        dark_e=known.dark_e_per_s * film.exposure_s,
        masked=film.masked,
    )
    profile = make_measured_profile(
        body,
        known,
        base=session.config.camera.profile,
        name=known.name,
        description=f"{session.camera.model} at ISO {iso}, measured on the bench",
        source="photon transfer by pdcd calibrate",
    )
    _keep_below(session, known.saturation_dn(iso), profile.saturation_dn(iso))
    figures = body.figures()
    offset, sigma = body.offset_refreshes
    black = np.array([body.black_sigma])
    return StepOutcome(
        figures=figures,
        words={"camera.profile": ConfigValue(_PROFILE)},
        arrays={
            EDGE_KEY: np.array([offset, sigma]) * session.refresh_s,
            GAIN_KEY: np.array(body.gain),
            BLACK_SIGMA_KEY: black,
        },
        profile=profile,
        advice=_advice(body),
        picture=lambda figure: _draw(figure, body, plan),
    )


def _keep_below(session: CalibrationSession, believed_dn: float, found_dn: float) -> None:
    """Make later photos shorter where the sensor saturates sooner than was believed."""
    if found_dn < believed_dn:
        session.full = max(LEAST, int(session.full * found_dn / believed_dn))


class _Frame(NamedTuple):
    """samples : (P, h, w), as in `RawFrame`. black : (P,) float32, their black level."""

    samples: NDArray[np.uint16] | NDArray[np.float32]
    black: _Planes


class Film(Mapping[str, _Planes]):
    """Photos by name, as planes in DN minus black; stored as the numbers of their files."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}
        self._black: list[Floats] = []
        self.exposure_s, self.masked = 0.0, True

    def keep(self, taken: CalibrationPhoto) -> None:
        """Hold one photo."""
        raw: RawFrame = taken.raw
        black = raw.black.astype(np.float32)
        self._frames[taken.name] = _Frame(raw.samples, black)
        self._black.append(raw.black)
        self.masked = self.masked and raw.masked
        self.exposure_s = raw.exposure_s or taken.open_s

    @property
    def black_dn(self) -> Floats:
        """(P,) the black that was subtracted, on average."""
        return np.asarray(np.mean(self._black, axis=0), np.float64)

    def __getitem__(self, name: str) -> _Planes:
        samples, black = self._frames[name]
        return samples.astype(np.float32) - black[:, None, None]

    def __iter__(self) -> Iterator[str]:
        return iter(self._frames)

    def __len__(self) -> int:
        return len(self._frames)


def _advice(body: SensorMeasurement) -> tuple[str, ...]:
    """What to do about it."""
    found = []
    for figure in body.figures():
        if figure.verdict is Verdict.GOOD:
            continue
        if figure.name.endswith("saturation_dn"):
            found.append("no dose saturated the sensor: its upper end is still taken from a table")
        elif figure.name.endswith("linearity"):
            found.append(
                "light is not proportional to the number of refreshes: let the lamp warm up, "
                "switch eco mode and dynamic contrast off, then see that the camera's RAW is not "
                "compressed"
            )
        elif figure.name.endswith("read_noise_e"):
            found.append("rounding hides the read noise: use a higher ISO to measure it")
        else:
            found.append(
                "the colours differ in gain: switch off whatever the camera does to its RAW files"
            )
    return tuple(found)


def _draw(figure: Any, body: SensorMeasurement, plan: SensorPlan) -> None:
    """How far each dose is off its line, plane by plane."""
    doses = np.sort(np.array(list(plan.doses.values()), np.float64))
    axes = figure.subplots()
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color=PLOT_GREY, label="limits" if limit > 0.0 else None)
    looks = PLOT_CHANNELS if len(body.lines) > 1 else (("black", "o"),)
    for name, line, (colour, marker) in zip(body.names, body.lines, looks, strict=True):
        full = line.saturation_dn
        said = "not reached" if full is None else f"{full:.0f} DN above black"
        axes.plot(
            doses, 100.0 * np.asarray(line.deviations), marker=marker, color=colour,
            label=f"{name}: upper end {said}",
        )  # fmt: skip
    axes.legend(ncols=2, loc="upper center")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.3 * (high - low))  # the legend hides nothing
    (gain, sigma), (read, _) = body.gain, body.read_noise
    label_plot(
        axes,
        "Linearity: how far light is off the line through all doses\n"
        f"gain {gain:.4g} +- {sigma:.2g} e-/DN, read noise {read:.3g} e-",
        "white refreshes", "off the line, in %",
    )  # fmt: skip
