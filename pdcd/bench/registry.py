"""The table of drivers, and how to load one: nothing is imported until it is asked for.

Drivers of other packages join by an entry point of the group `pdcd.drivers`, named
``<role>.<name>`` (``display.acme``) and pointing at a class (``acme.pdcd:AcmeDisplay``). They
cannot take over the name of one of pdcd's own drivers.
"""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple, Protocol, get_args

from pdcd.errors import DeviceLost, DriverUnavailable, PdcdError, to_typed_error

logger = logging.getLogger(__name__)

DriverRole = Literal["display", "shutter", "readout", "preview", "usb"]
"""Roles of drivers. The first three make a rig; a bench may have the others as well: `preview` is
the camera's finder (`pdcd.bench.devices.Preview`), and `usb` a pyusb backend with virtual devices,
for drivers that ask for it (`DriverContext.usb_backend`)."""
ROLES: tuple[DriverRole, ...] = get_args(DriverRole)
_GROUP = "pdcd.drivers"
"""Entry-point group for the drivers of other packages."""

PACKAGE = "pdcd._drivers" if (Path(__file__).parents[1] / "_drivers").is_dir() else "drivers"
"""The package of pdcd's own drivers: beside pdcd in a checkout, within it in an installed wheel."""

DRIVERS: Mapping[tuple[str, str], str] = {
    ("display", "dlpc-video"): f"{PACKAGE}.dlpc_video:DlpcVideoDisplay",
    ("display", "dlpc900"): f"{PACKAGE}.dlpc900.display:Dlpc900Display",
    ("display", "mock"): f"{PACKAGE}.mock:MockDisplay",
    ("display", "x11"): f"{PACKAGE}.x11:X11Display",
    ("shutter", "genicam"): f"{PACKAGE}.genicam.roles:GenicamShutter",
    ("shutter", "gphoto2"): f"{PACKAGE}.gphoto:GphotoShutter",
    ("shutter", "mock"): f"{PACKAGE}.mock:MockShutter",
    ("shutter", "ptp"): f"{PACKAGE}.ptp.shutter:PtpShutter",
    ("shutter", "serial"): f"{PACKAGE}.serial_shutter:SerialShutter",
    ("shutter", "virtual-genicam"): f"{PACKAGE}.virtual_genicam.bench:VirtualGenicamShutter",
    ("readout", "folder"): f"{PACKAGE}.folder:FolderReadout",
    ("readout", "genicam"): f"{PACKAGE}.genicam.roles:GenicamReadout",
    ("readout", "gphoto2"): f"{PACKAGE}.gphoto:GphotoReadout",
    ("readout", "mock"): f"{PACKAGE}.mock:MockReadout",
    ("readout", "ptp"): f"{PACKAGE}.ptp.readout:PtpReadout",
    ("readout", "virtual-genicam"): f"{PACKAGE}.virtual_genicam.bench:VirtualGenicamReadout",
    ("preview", "gphoto2"): f"{PACKAGE}.gphoto.finder:GphotoPreview",
    ("preview", "mock"): f"{PACKAGE}.mock.finder:MockPreview",
    ("preview", "ptp"): f"{PACKAGE}.ptp.finder:PtpPreview",
    ("usb", "virtual"): f"{PACKAGE}.virtual_camera:BenchUsb",
    ("usb", "virtual-dlpc900"): f"{PACKAGE}.virtual_dlpc900:BenchDmdUsb",
}
"""(role, name) -> "module:Class" of the drivers that come with pdcd."""


class _DriverClass(Protocol):
    """What the registry needs of a driver's class, whatever its role."""

    maturity: str
    """One of ``broken``, ``experimental``, ``beta``, ``stable``; stored with every run."""

    def create(self, context: Any) -> Any:
        """Build the driver from the rig's `DriverContext`; in the class itself this is a
        classmethod."""
        ...


class _Entry(NamedTuple):
    """One known driver: its "module:Class" and the distribution it comes from."""

    target: str
    origin: str


def list_known_drivers() -> dict[tuple[str, str], _Entry]:
    """Every driver by (role, name): pdcd's own first, then those of installed packages."""
    known = {key: _Entry(target, "pdcd") for key, target in DRIVERS.items()}
    for point in entry_points(group=_GROUP):
        role, _, name = point.name.partition(".")
        if role not in ROLES or not name:
            logger.warning("driver ignored name=%s reason=not-role.name", point.name)
        elif (role, name) in known:
            logger.warning("driver ignored name=%s reason=name-taken", point.name)
        else:
            known[role, name] = _Entry(point.value, _distribution(point))
    return known


def load_driver(role: DriverRole, name: str) -> _DriverClass:
    """Import the driver `name` for `role` and return its class; ``create(context)`` builds it.

    Raises DriverUnavailable, worded apart, when the name is unknown, when the module does not
    import (a missing vendor library, say), and when the module lacks the class.
    """
    # Other packages cannot take over a name of pdcd's own, so they need not be searched for it.
    if own := DRIVERS.get((role, name)):
        return _import(role, name, own)
    known = list_known_drivers()
    if (role, name) not in known:
        names = sorted(n for r, n in known if r == role)
        raise DriverUnavailable(
            f"no driver is called {name!r}",
            device=role,
            hint=f"known are: {', '.join(names) or 'none'}; see pdcd drivers",
        )
    return _import(role, name, known[role, name].target)


@contextmanager
def name_driver_errors(role: DriverRole) -> Iterator[None]:
    """Turn foreign exceptions of a driver into DeviceLost, which names the driver. Used where
    drivers are made and opened: their libraries may even try to end the program."""
    try:
        yield
    except (PdcdError, KeyboardInterrupt):
        raise
    except BaseException as err:
        raise DeviceLost(
            f"its driver failed: {to_typed_error(err).message}",
            device=role,
            hint="see its log, and whether there is a newer one",
        ) from err


def describe_drivers() -> list[dict[str, str | bool | None]]:
    """One row for each known driver, for `pdcd drivers`: what it is and, if unavailable, why.

    Every driver is imported to find out, but none is created: no device is touched.
    """
    rows: list[dict[str, str | bool | None]] = []
    for (role, name), entry in sorted(list_known_drivers().items()):
        maturity, reason = None, None
        try:
            maturity = _import(role, name, entry.target).maturity
        except DriverUnavailable as err:
            reason = err.message
        rows.append(
            {
                "role": role,
                "name": name,
                "origin": entry.origin,
                "target": entry.target,
                "maturity": maturity,
                "available": reason is None,
                "reason": reason,
            }
        )
    return rows


def import_driver_module(name: str) -> ModuleType:
    """A module of pdcd's own drivers, by its name among them ("ptp.doctor"); for commands that are
    about one driver. Raises ImportError."""
    return importlib.import_module(f"{PACKAGE}.{name}")


def _import(role: str, name: str, target: str) -> _DriverClass:
    """Import "module:Class" and check that the class is a driver's."""
    module_name, _, class_name = target.partition(":")
    try:
        module = importlib.import_module(module_name)
    except KeyboardInterrupt:
        raise
    # A driver's module may fail in any way that its vendor's library does; only this driver is lost
    # then.
    except BaseException as err:
        why, remedy = _explain_failure(module_name, err)
        raise DriverUnavailable(
            f"driver {name!r}: {why}", device=role, hint=f"{remedy}, or choose another driver"
        ) from err
    found = getattr(module, class_name, None)
    missing = [part for part in ("create", "maturity") if not hasattr(found, part)]
    if found is None or missing:
        what = "has no such class" if found is None else f"lacks {' and '.join(missing)}"
        raise DriverUnavailable(
            f"driver {name!r}: {target} {what}",
            device=role,
            hint="the package that brings the driver does not fit this pdcd",
        )
    return found  # type: ignore[no-any-return]


def _distribution(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "unknown"


def _explain_failure(module: str, error: BaseException) -> tuple[str, str]:
    """Why a driver's module does not import, and what to do about it."""
    # Imported here because most drivers do import, and do not need it.
    from pdcd.extras import OPTIONAL, explain_missing, suggest_install

    why, remedy = f"{module} does not import: {type(error).__name__}: {error}", None
    if isinstance(error, ModuleNotFoundError):
        missing = explain_missing(error)
        if missing is not None:
            why, remedy = missing.message, missing.hint
        elif error.name in OPTIONAL:
            remedy = suggest_install(error.name)
    return why, remedy or "install what it needs"
