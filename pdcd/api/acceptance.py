"""The acceptance of a bench: a fixed list of checks in front of a white card, on one page to print.

All checks use what other parts of the program report: doctors, the calibration in use, and two
captures of direct light. Only the comparison of these two is computed here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pdcd.api.local import LocalBench
from pdcd.api.run import Run
from pdcd.arrays import Floats
from pdcd.bench.calibration import read_calibration
from pdcd.bench.devices import Finding
from pdcd.bench.tables import Config
from pdcd.calibration.light.light_step import find_card_albedo
from pdcd.calibration.steps import order_steps
from pdcd.files.put import replace_file
from pdcd.pages.render import render_page
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import convert_record_errors
from pdcd.pictures.picture import PictureWithErrors
from pdcd.printable import to_percent
from pdcd.runs.record import PanelLook
from pdcd.verdict.assess import assess_places
from pdcd.verdict.causes import Cause, Grade, VerdictFinding
from pdcd.watch import Watch

_TEMPLATE = "acceptance.html"
_STEPS: dict[Cause | None, str] = {
    Cause.CODES_APART: "timing",
    Cause.TIMES_UNSURE: "timing",
    Cause.MASK_BLUR: "registration",
}
"""The calibration step to run for each cause of wrong places; for other causes it is `geometry`."""
SCALE_OFF, NOISE_OFF, REPEAT_OFF = 0.1, 1.25, 1.5
SUM_OFF, CARD_INDIRECT, ROOM_LIGHT = 0.03, 0.03, 0.05
FULL_LEAST, FULL_MOST = 0.1, 0.98
"""Limits of: white relative to the card's albedo; noise and differences relative to their error
bars; the sum, the card's indirect light and the room's light, relative to white; and the brightest
sample, relative to a full one."""
_State = Literal["pass", "fail", "not tried"]


@dataclass(frozen=True)
class AcceptanceRow:
    """One check: what was found, what is accepted, and what to do where it fails."""

    check: str
    state: _State
    found: str
    limit: str
    advice: str = ""


@dataclass(frozen=True)
class AcceptanceRecord:
    """All rows of a bench, with its name, its devices and the time."""

    bench: str
    when_utc: str
    devices: tuple[tuple[str, str], ...]
    rows: tuple[AcceptanceRow, ...]

    @property
    def accepted(self) -> bool:
        """Whether nothing failed."""
        return all(row.state != "fail" for row in self.rows)

    @property
    def result(self) -> str:
        """Whether the bench is accepted, in words, and which checks were not tried."""
        untried = ", ".join(row.check for row in self.rows if row.state == "not tried")
        words = "accepted" if self.accepted else "not accepted"
        return f"{words}; not tried: {untried}" if untried else words


def check_acceptance(
    config: Config, findings: Iterable[Finding], folder: Path | None = None
) -> AcceptanceRecord:
    """Take the photos and compute all rows, assuming that a flat white card stands in front of the
    bench. For `pdcd doctor bench`. findings : of the doctors. folder : where the runs go. Raises
    PdcdError."""
    rows = [*_doctor_rows(findings)]
    with LocalBench(config, folder) as bench:
        first, second = (bench.capture("direct", seed=seed, progress=False) for seed in (0, 1))
        passed_over = bench.note
    rows += [*_calibration_rows(first, passed_over), *_photo_rows(config, first, second)]
    devices = tuple(_devices(first))
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return AcceptanceRecord(config.rig.name, when, devices, tuple(rows))


def write_acceptance(record: AcceptanceRecord, path: Path) -> None:
    """Write the page. Raises NoSpaceError, or DiskError for any other refusal of the disk."""
    replace_file(path, render_page(_TEMPLATE, record=record).encode("utf-8"))


def _devices(run: Run) -> Iterator[tuple[str, str]]:
    told: dict[str, Any] = run.manifest.drivers
    camera, panels = told.get("camera", {}), told.get("display", {}).get("identity", {})
    yield "camera", f"{camera.get('model', '?')}, serial {camera.get('serial') or 'unknown'}"
    for name in ("projector", "mask"):
        yield name, str(panels.get(name, "?"))
    yield "shutter", str(told.get("shutter", {}).get("model", "?"))


def _doctor_rows(findings: Iterable[Finding]) -> Iterator[AcceptanceRow]:
    states: dict[str, _State] = {"fault": "fail", "warning": "pass", "unknown": "not tried"}
    worst = [one for one in findings if one.state in states]
    if not worst:
        yield AcceptanceRow("devices", "pass", "nothing to mend", "nothing to mend")
    for one in worst:
        yield AcceptanceRow(
            f"devices: {one.what}", states[one.state], one.found, "nothing to mend", one.hint or ""
        )


def _calibration_rows(run: Run, passed_over: str) -> Iterator[AcceptanceRow]:
    """Rows on the calibration that a run used. passed_over : those it did not use, in words."""
    used = run.manifest.config["calibration"]
    if used.get("sha256") is None:
        yield AcceptanceRow(
            "calibration", "fail", passed_over or "none is in use", "one that fits",
            "run pdcd calibrate",
        )  # fmt: skip
        return
    record, _ = read_calibration(Path(used["use"]))
    if passed_over:
        yield AcceptanceRow("calibration", "pass", passed_over, "one that fits")
    for step in record.steps:
        bad = step.verdict == "bad" or step.name in record.left_out
        yield AcceptanceRow(
            f"calibration: {step.name}", "fail" if bad else "pass",
            record.left_out.get(step.name, f"{step.verdict}, {step.made_utc[:10]}"), "not bad",
            "; ".join(step.advice),
        )  # fmt: skip
    made = {step.name for step in record.steps} | set(record.taken_over)
    if absent := [name for name in order_steps(()) if name not in made]:
        found = f"not made by it: {', '.join(absent)}; those of one before are used"
        yield AcceptanceRow("calibration: other steps", "not tried", found, "all made")


def _photo_rows(config: Config, first: Run, second: Run) -> Iterator[AcceptanceRow]:
    """Rows from two captures of direct light, each alone and compared with each other."""
    runs = first, second
    shots = [shot for run in runs for shot in run.manifest.run.shots]
    missed = sum(shot.missed for shot in shots)
    verified = all(shot.verified for shot in shots)
    yield _row(
        "timing", missed == 0 and verified,
        f"{missed} refreshes missed, times {'verified' if verified else 'not verified'}",
        "0 missed, verified", "see that nothing else runs on the display; run pdcd timing",
    )  # fmt: skip
    (pictures, places), (others, _) = map(_decode, runs)
    yield make_place_row(first.manifest.run.panels, places)
    yield from _light_rows(config, first)
    yield from _compared((pictures, others))
    bad = [f"{run.job}: {run.quality.reasons[0]}" for run in runs if run.verdict == "bad"]
    yield _row("verdicts", not bad, bad[0] if bad else "no photo is bad", "no photo is bad")


def _row(check: str, good: bool, found: str, limit: str, advice: str = "") -> AcceptanceRow:
    return AcceptanceRow(check, "pass" if good else "fail", found, limit, "" if good else advice)


def _decode(run: Run) -> tuple[Mapping[str, PictureWithErrors], list[VerdictFinding]]:
    """All pictures of a run, and what the verdict says about the places of panels and camera."""
    record = run.manifest.run
    with convert_record_errors(run.folder):
        decoded = Darkroom(run.folder, record).decoded(Watch())
        return decoded.pictures, assess_places(record, decoded)


def make_place_row(look: PanelLook | None, said: Iterable[VerdictFinding]) -> AcceptanceRow:
    """Whether both panels lie where they are believed to, according to the verdict. For
    `check_acceptance`.

    look : the result of photos of blocks on both panels, None where none were wanted. said : what
        the verdict says about places; it is no fault that no photos were taken to look.
    """
    check, limit = "places of the panels", "as in the verdict of a photo"
    wrong = [
        one for one in said if one.grade > Grade.REMARK and one.cause is not Cause.NOBODY_LOOKED
    ]
    if wrong:
        worst = max(wrong, key=lambda one: one.grade)
        step = _STEPS.get(worst.cause, "geometry")
        return AcceptanceRow(check, "fail", worst.text, limit, f"run pdcd calibrate {step}")
    if look is None or look.mask is None:
        why = "no photos of blocks" if look is None or not look.why else look.why
        return AcceptanceRow(check, "not tried", why, limit)
    found = f"as believed, to {look.sigma_px:.2g} projector pixels"
    return AcceptanceRow(check, "pass", found, limit)


def _light_rows(config: Config, run: Run) -> Iterator[AcceptanceRow]:
    """Rows on light: in the files, from the room, and relative to the card's albedo."""
    record, field = run.manifest.run, run.pictures["white"].max(axis=-1) > 0.0
    white, indirect = (run.pictures[n].astype(np.float64)[field] for n in ("white", "indirect"))
    shot = next(one for one in record.shots if one.name == "white")
    level = record.profile.saturation_dn(shot.iso) - record.profile.black_dn
    peak = float(np.quantile(run.raw("white"), 0.999)) / level
    yield _row(
        "light level", FULL_LEAST <= peak <= FULL_MOST, f"{to_percent(peak)} of full",
        f"{to_percent(FULL_LEAST)} to {to_percent(FULL_MOST)}", "set aperture, ISO or exposure",
    )  # fmt: skip
    dark = record.dark or record.room
    if dark is None:
        looked = any(one.peak is None for one in run.manifest.meter)
        found = "nothing was seen by the dark photos" if looked else "no dark photo was taken"
        yield AcceptanceRow("dark", "pass" if looked else "not tried", found, "")
    else:
        light = Darkroom(run.folder, record).ambient(dark).light
        share = float(np.mean(light[field]) / np.mean(white))
        yield _row(
            "dark", share <= ROOM_LIGHT,
            f"{to_percent(share)} of white" if share > 1e-4 else "under 0.01 % of white",
            f"at most {to_percent(ROOM_LIGHT)}", "darken the room; look at the panels' contrast",
        )  # fmt: skip
    albedo, _ = find_card_albedo(config)
    off = float(np.quantile(white, 0.9)) / albedo - 1.0
    yield _row(
        "brightness of the card", abs(off) <= SCALE_OFF,
        f"{to_percent(off)} from its albedo of {albedo:g}", f"within {to_percent(SCALE_OFF)}",
        "clean the lens and its stops; run pdcd calibrate light",
    )  # fmt: skip
    share = _rms(indirect) / _rms(white)
    yield _row(
        "indirect light of the card", share <= CARD_INDIRECT, f"{to_percent(share)} of white",
        f"at most {to_percent(CARD_INDIRECT)}",
        "run pdcd calibrate timing and geometry: direct light gets through the codes",
    )  # fmt: skip


def _compared(made: Sequence[Mapping[str, PictureWithErrors]]) -> Iterator[AcceptanceRow]:
    """Rows on whether the pictures of two captures differ by as much as their error bars say."""
    # Outside the field, and where a sample is full, nothing is known: error bars are infinite.
    known = np.logical_and.reduce([np.isfinite(one.sigma) for two in made for one in two.values()])
    off = {name: made[0][name].image - made[1][name].image for name in ("white", "direct")}
    for check, name, bars, most, advice in (
        ("noise", "white", [one["white"].sensor for one in made], NOISE_OFF,
         "name this camera's own profile, or run pdcd calibrate sensor"),
        ("repeatability", "direct", [one["direct"].sigma for one in made], REPEAT_OFF,
         "see that lamp, card and mounts are steady"),
    ):  # fmt: skip
        times = _rms((off[name] / np.hypot(*bars))[known])
        yield _row(
            check, times <= most, f"two {name} photos differ by {times:.2f} times their error bars",
            f"at most {most:g} times", advice,
        )  # fmt: skip
    rest = made[0]["indirect"].image + made[1]["direct"].image - made[0]["white"].image
    share = _rms(rest[known]) / _rms(made[0]["white"].image[known])
    yield _row(
        "direct and indirect add up to white", share <= SUM_OFF, f"{to_percent(share)} left over",
        f"at most {to_percent(SUM_OFF)} of white", "see that lamp and room are steady",
    )  # fmt: skip


def _rms(values: Floats) -> float:
    """RMS of known values; infinite if there are none, which exceeds every limit."""
    return float(np.sqrt(np.mean(values**2))) if values.size else np.inf
