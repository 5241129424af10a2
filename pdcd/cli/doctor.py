"""`pdcd doctor ...`: which parts of the bench work, which do not, and what to do about it."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Generator, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdcd.bench.config import load_config
from pdcd.bench.devices import Finding
from pdcd.bench.registry import import_driver_module
from pdcd.bench.tables import Config
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say_json, say_table, say_text
from pdcd.errors import ConfigError

if TYPE_CHECKING:
    from pdcd.api.acceptance import AcceptanceRow
    from pdcd.bench.devices import DriverContext

_DOCTORS = {
    "mock": "ptp.doctor:examine_ptp",
    "ptp": "ptp.doctor:examine_ptp",
    "genicam": "genicam.doctor:examine_genicam",
    "virtual-genicam": "virtual_genicam.bench:examine_virtual_genicam",
}
"""Functions that examine a camera more closely than any readout, by its driver; given by name, as
drivers are loaded. Without a configuration (mock), a Canon is looked for."""

_DISPLAY_DOCTORS = {
    "dlpc-video": "dlpc_video:examine_dlpc_video",
    "dlpc900": "dlpc900.doctor:examine_dlpc900",
}
"""The same for displays that are more than outputs of an X server."""


def diagnose_display(args: argparse.Namespace) -> int:
    """Look at both panels, and at their X server; fails when anything must be mended."""
    from pdcd.api.signals import send_signals_to

    config = load_config(args.config)
    with send_signals_to(signal.default_int_handler):  # which leaves panels black on its way out
        findings = list(_examine_panels(config, args.display))
    return _report(findings, as_json=args.json)


def _examine_panels(config: Config, display_name: str | None) -> Iterator[Finding]:
    from pdcd.bench.clock import RealClock
    from pdcd.bench.devices import DriverContext
    from pdcd.presenter.examine import examine_display

    known = _DISPLAY_DOCTORS.get(config.display.driver)
    if known is None:
        return examine_display(config, display_name)
    return _ask_doctor(known, DriverContext(config=config, clock=RealClock()))


def _ask_doctor(known: str, context: DriverContext) -> Generator[Finding, None, Any]:
    module, _, function = known.partition(":")
    asked: Generator[Finding, None, Any] = getattr(import_driver_module(module), function)(context)
    return asked


def diagnose_camera(args: argparse.Namespace) -> int:
    """Look at the camera, without a photo; fails when anything must be mended."""
    return _report(_examine_camera(load_config(args.config), args.raw), as_json=args.json)


def _examine_camera(config: Config, raw: Path | None) -> Iterator[Finding]:
    from pdcd.bench.clock import RealClock
    from pdcd.bench.devices import DriverContext
    from pdcd.capture.bench_check import examine_frame, examine_readout

    # Cameras run in real time, whatever clock the rest of the rig would use.
    context = DriverContext(config=config, clock=RealClock())
    # A camera read through a folder may still drive the shutter; a mock shutter implies no camera.
    drivers = (config.camera.driver, *({config.trigger.driver} - {"mock"}))
    known = next((_DOCTORS[name] for name in drivers if name in _DOCTORS), None)
    if known is None:
        told = yield from examine_readout(context)
    else:
        told = yield from _ask_doctor(known, context)
    yield from examine_frame(config, raw, told)


def examine_bench(config: Config) -> Iterator[Finding]:
    """Yield all doctors' findings on the devices of a configuration; nothing is exposed."""
    from pdcd.bench.click import examine_shutter

    if config.display.driver in ("x11", *_DISPLAY_DOCTORS):
        yield from _examine_panels(config, None)
    if config.camera.driver in ("ptp", "genicam"):
        yield from _examine_camera(config, None)
    yield from examine_shutter(config, click=False)


def diagnose_bench(args: argparse.Namespace) -> int:
    """Run the acceptance checks, two captures among them; fails when any of them does."""
    from pdcd.api.acceptance import check_acceptance, write_acceptance
    from pdcd.api.signals import send_signals_to
    from pdcd.files.put import check_replaceable

    config = load_config(args.config)
    if args.page is not None:
        check_replaceable(args.page)
    with send_signals_to(signal.default_int_handler):  # which leaves panels black on its way out
        record = check_acceptance(config, list(examine_bench(config)), args.out)
    if args.json:
        say_json({"accepted": record.accepted, "bench": record.bench, "rows": record.rows})
    else:
        say_table([["check", "result", "found", "limit"], *map(_format_check, record.rows)])
        for row in record.rows:
            if row.state == "fail" and row.advice:
                say_text(f"{row.check}: {row.advice}")
        say_text(record.result)
    if args.page is not None:
        write_acceptance(record, args.page)
    return DONE if record.accepted else FAILED


def _format_check(row: AcceptanceRow) -> list[str]:
    return [row.check, row.state, row.found, row.limit]


def diagnose_trigger(args: argparse.Namespace) -> int:
    """Examine the shutter, and click it once if asked to; fails when anything must be mended."""
    from pdcd.api.signals import send_signals_to
    from pdcd.bench.click import examine_shutter

    config = load_config(args.config)
    longest_s = config.limits.max_exposure_s
    if not 0.0 <= args.seconds <= longest_s:
        raise ConfigError(
            f"--seconds {args.seconds:g} is not between 0 and limits.max_exposure_s = {longest_s:g}"
        )
    with send_signals_to(signal.default_int_handler):  # which closes the shutter on its way out
        findings = list(examine_shutter(config, click=args.click, seconds=args.seconds))
    return _report(findings, as_json=args.json)


def _report(findings: Iterable[Finding], *, as_json: bool) -> int:
    found = list(findings)
    faults = sum(f.state == "fault" for f in found)
    if as_json:
        say_json({"fit": not faults, "findings": found})
        return FAILED if faults else DONE
    say_findings(found)
    return FAILED if faults else DONE


def say_findings(found: list[Finding]) -> None:
    """Print findings as a table, what to do about each, and an overall verdict."""
    say_table([[f.state, f.what, f.found] for f in found])
    for finding in found:
        if finding.hint is not None:
            say_text(f"{finding.what}: {finding.hint}")
    say_text(_verdict(found, sum(f.state == "fault" for f in found)))


def _verdict(found: list[Finding], faults: int) -> str:
    """The last line; it names what was not tried, which is not called sound."""
    if faults:
        return f"{faults} to mend"
    unknown = ", ".join(f.what for f in found if f.state == "unknown")
    return f"nothing to mend so far; not tried: {unknown}" if unknown else "nothing to mend"
