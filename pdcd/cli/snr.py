"""`pdcd snr`: the paper's appendix number by number, and the same for the user's own sensor."""

from __future__ import annotations

import argparse
import math
from itertools import product

import msgspec

from pdcd.cli.exits import DONE
from pdcd.cli.output import say, say_json, say_table, say_text
from pdcd.sensor import snr as model
from pdcd.sensor.appendix import PrintedRow, compute_appendix_rows
from pdcd.sensor.profile import SensorProfile, load_profile

_THERMAL_TERMS: dict[model.Thermal, str] = {
    "paper": "paper's thermal term",
    "shot": "dark shot noise",
}
"""Names in tables of the two conventions of `pdcd.sensor.snr`."""


class _BreakEven(msgspec.Struct, frozen=True):
    """Where the mask stops paying; `read_noise_e` is None if the two SNRs are never equal."""

    light: float
    transmission: float
    goal: str
    thermal: str
    read_noise_e: float | None
    verdict: str


def print_snr(args: argparse.Namespace) -> int:
    """Print the appendix' table, then SNRs and break-even read noises of one sensor."""
    profile = load_profile(args.profile)
    iso: int = profile.isos[0] if args.iso is None else args.iso
    pixel = model.make_sensor_pixel(
        profile, iso, codes=args.codes, exposure_s=args.exposure, signal_e=args.signal
    )
    rows = model.compute_sensor_rows(profile, iso, pixel, args.transmission)
    even = list_break_even_rows(pixel, args.transmission)
    appendix = compute_appendix_rows()
    if args.json:
        say_json(
            {
                "appendix": appendix,
                "profile": profile.name,
                "estimated": profile.estimated,
                "iso": iso,
                "pixel": pixel,
                "transmission": args.transmission,
                "opening_limit_db": model.compute_opening_limit_db(pixel.codes),
                "rows": rows,
                "break_even": even,
            }
        )
        return DONE
    _say_appendix(appendix)
    say("")
    _say_sensor(profile, pixel, rows, args.transmission)
    say("")
    _say_break_even(even)
    return DONE


def list_break_even_rows(pixel: model.SnrPixel, transmission: float) -> list[_BreakEven]:
    """Break-even read noises for each light, mask (ideal, LCD, the user's), goal and convention."""
    masks = sorted({1.0, model.LCD_TRANSMISSION, transmission}, reverse=True)
    made = []
    for light, of in ((1.0, pixel), (model.DIM, pixel.dimmed())):
        for mask, goal, thermal in product(masks, model.SNR_GOALS, model.THERMALS):
            read_noise_e = model.break_even_read_noise_e(of, goal, thermal, mask)
            kept = read_noise_e if 0.0 < read_noise_e < math.inf else None
            made.append(_BreakEven(light, mask, goal, thermal, kept, _verdict(read_noise_e)))
    return made


def _verdict(read_noise_e: float) -> str:
    if read_noise_e == 0.0:
        return "never"
    if read_noise_e == math.inf:
        return "at any read noise"
    return f"below {read_noise_e:.3g} e-"


def _say_appendix(rows: tuple[PrintedRow, ...]) -> None:
    say("appendix of the paper (profile mark2)")
    table = [["quantity", "printed", "ours", "dark shot noise"]]
    for row in rows:
        # Two digits more than in the paper show how it got its last one.
        places = len(row.printed.partition(".")[2])
        places += 2 if places else 0
        shot = "" if row.shot is None else f"{row.shot:.{places}f}"
        table.append([row.quantity, row.printed, f"{row.ours:.{places}f}", shot])
    say_table(table)
    for row in rows:
        if row.note:
            say_text(f"{row.quantity}: {row.note}")


def _say_sensor(
    profile: SensorProfile,
    pixel: model.SnrPixel,
    rows: tuple[model.SensorRow, ...],
    transmission: float,
) -> None:
    estimated = ", estimated" if profile.estimated else ""
    say(f"sensor {profile.name}: {profile.description}{estimated}")
    rate_hz = pixel.codes / pixel.exposure_s
    say_table(
        [
            ["signal", f"{pixel.signal_e:.6g} e- in {pixel.exposure_s:g} s through an ideal mask"],
            ["mask transmission", f"{transmission:g}"],
            ["mask-less photos", f"{pixel.codes}, {rate_hz:.3g} a second"],
            [
                "independent codes",
                f"{pixel.codes / model.SHIFTS_PER_CODE:g}: at random, unequal opening alone limits "
                f"indirect light to {model.compute_opening_limit_db(pixel.codes):.1f} dB",
            ],
        ]
    )
    say("")
    table = [["procedure", "light", "ISO", "signal", "additive"]]
    table[0] += [f"SNR, {_THERMAL_TERMS[thermal]}" for thermal in model.THERMALS]
    for row in rows:
        table.append(
            [row.procedure, f"{row.light:g}", str(row.iso)]
            + [f"{row.signal_e:.5g} e-", f"{row.additive_e:.4g} e-"]
            + [f"{ratio_db:.2f} dB" for ratio_db in (row.paper_db, row.shot_db)]
        )
    say_table(table)
    say_text(
        "signed: a difference as large as all of the light; smaller ones cost pair and sum alike"
    )


def _say_break_even(rows: list[_BreakEven]) -> None:
    say("the mask stops paying (read noise, the same in all photos)")
    table = [["light", "mask passes"]]
    table[0] += [
        f"{goal} goal, {_THERMAL_TERMS[thermal]}"
        for goal, thermal in product(model.SNR_GOALS, model.THERMALS)
    ]
    columns = len(model.SNR_GOALS) * len(model.THERMALS)
    for start in range(0, len(rows), columns):
        first = rows[start]
        verdicts = [row.verdict.replace("below", "<") for row in rows[start : start + columns]]
        table.append([f"{first.light:g}", f"{first.transmission:g}", *verdicts])
    say_table(table)
