"""The driver table: lazy loading, three ways to fail, drivers of other packages."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from pdcd.bench import registry
from pdcd.errors import DriverUnavailable
from tests.places import ROOT


class FakeDriver:
    """Enough of a driver for the registry."""

    maturity = "beta"

    @classmethod
    def create(cls, context: object) -> FakeDriver:
        return cls()


class NoDriver:
    """A class that is no driver at all."""


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A table with one driver that works and several that do not."""
    good = ModuleType("fake_good")
    good.Good = FakeDriver  # type: ignore[attr-defined]
    good.Bare = NoDriver  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "fake_good", good)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "fake_bad.py").write_text("raise RuntimeError('libvendor is too old')\n")
    (tmp_path / "fake_ends.py").write_text("import sys\nsys.exit('no licence')\n")
    monkeypatch.setattr(
        registry,
        "DRIVERS",
        {
            ("display", "good"): "fake_good:Good",
            ("display", "absent"): "fake_good:Absent",
            ("display", "bare"): "fake_good:Bare",
            ("readout", "vendor"): "fake_gone.sub:Camera",
            ("shutter", "bad"): "fake_bad:Shutter",
            ("shutter", "ends"): "fake_ends:Shutter",
        },
    )


def installed(folder: Path, entries: str, name: str = "acme-pdcd") -> None:
    """Make `folder` look like a place where a distribution with these entry points is installed."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[pdcd.drivers]\n{entries}\n")


def test_every_driver_of_our_own_loads() -> None:
    assert {role for role, _ in registry.DRIVERS} <= set(registry.ROLES)
    for role, name in (*((r, "mock") for r in registry.ROLES[:3]), ("usb", "virtual")):
        found = registry.load_driver(role, name)
        assert found.maturity in ("broken", "experimental", "beta", "stable")
        assert callable(found.create)


def test_driver_is_imported_only_when_asked_for(
    fakes: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    imported: list[str] = []
    real = importlib.import_module

    def spy(name: str) -> ModuleType:
        imported.append(name)
        return real(name)

    monkeypatch.setattr("importlib.import_module", spy)
    assert ("shutter", "bad") in registry.list_known_drivers()
    assert imported == []
    assert registry.load_driver("display", "good") is FakeDriver
    assert imported == ["fake_good"]


def test_unknown_name_lists_the_known_ones(fakes: None) -> None:
    with pytest.raises(DriverUnavailable) as caught:
        registry.load_driver("display", "goood")
    assert caught.value.device == "display"
    assert "'goood'" in caught.value.message
    assert caught.value.hint is not None
    assert "known are: absent, bare, good" in caught.value.hint


def test_name_of_another_role_is_unknown(fakes: None) -> None:
    with pytest.raises(DriverUnavailable, match=r"no driver is called 'good'.*known are: vendor;"):
        registry.load_driver("readout", "good")


@pytest.mark.parametrize(
    ("role", "name", "reason"),
    [
        ("readout", "vendor", "fake_gone.sub does not import: ModuleNotFoundError"),
        ("shutter", "bad", "fake_bad does not import: RuntimeError: libvendor is too old"),
        ("shutter", "ends", "fake_ends does not import: SystemExit: no licence"),
    ],
)
def test_module_that_does_not_import_tells_why(
    fakes: None, role: registry.DriverRole, name: str, reason: str
) -> None:
    with pytest.raises(DriverUnavailable) as caught:
        registry.load_driver(role, name)
    assert reason in caught.value.message
    assert caught.value.device == role
    assert caught.value.__cause__ is not None


@pytest.mark.parametrize(
    ("raised", "remedy"),
    [
        ("ModuleNotFoundError('', name='gphoto2')", "install gphoto2, or"),
        ("ModuleNotFoundError('', name='theirs')", "install what it needs, or"),
        ("ImportError('', name='gphoto2')", "install what it needs, or"),
    ],
)
def test_a_package_of_an_extra_is_told_by_the_line_that_installs_it(
    fakes: None, tmp_path: Path, raised: str, remedy: str
) -> None:
    (tmp_path / "fake_bad.py").write_text(f"raise {raised}\n")
    with pytest.raises(DriverUnavailable) as caught:
        registry.load_driver("shutter", "bad")
    assert f"{remedy} choose another driver" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("absent", "fake_good:Absent has no such class"),
        ("bare", "fake_good:Bare lacks create and maturity"),
    ],
)
def test_class_that_is_missing_or_no_driver_is_named(fakes: None, name: str, reason: str) -> None:
    with pytest.raises(DriverUnavailable) as caught:
        registry.load_driver("display", name)
    assert reason in caught.value.message


def test_other_packages_bring_drivers(fakes: None, tmp_path: Path) -> None:
    installed(
        tmp_path,
        "display.acme = fake_good:Good\npreview.acme = fake_good:Good\nusb.acme = fake_good:Good",
    )
    assert registry.list_known_drivers()["display", "acme"] == ("fake_good:Good", "acme-pdcd")
    for role in ("display", "preview", "usb"):
        assert registry.load_driver(role, "acme") is FakeDriver


def test_entry_points_that_do_not_fit_are_ignored_with_a_warning(
    fakes: None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    installed(tmp_path, "display.good = evil:Evil\nlamp.acme = a:B\nacme = a:B\ndisplay. = a:B")
    known = registry.list_known_drivers()
    assert known["display", "good"] == ("fake_good:Good", "pdcd"), "our own name stays ours"
    assert set(known) == set(registry.DRIVERS)
    warned = sorted(record.getMessage() for record in caplog.records)
    assert warned == [
        "driver ignored name=acme reason=not-role.name",
        "driver ignored name=display. reason=not-role.name",
        "driver ignored name=display.good reason=name-taken",
        "driver ignored name=lamp.acme reason=not-role.name",
    ]


def test_description_tells_what_works_and_why_the_rest_does_not(
    fakes: None, tmp_path: Path
) -> None:
    installed(tmp_path, "shutter.acme = acme_nowhere:S")
    rows = {(row["role"], row["name"]): row for row in registry.describe_drivers()}
    assert rows["display", "good"] == {
        "role": "display",
        "name": "good",
        "origin": "pdcd",
        "target": "fake_good:Good",
        "maturity": "beta",
        "available": True,
        "reason": None,
    }
    bad = rows["shutter", "bad"]
    assert (bad["available"], bad["maturity"]) == (False, None)
    assert "libvendor is too old" in str(bad["reason"])
    assert rows["shutter", "acme"]["origin"] == "acme-pdcd"
    assert len(rows) == 7


def test_drivers_do_not_name_their_own_package() -> None:
    """In the wheel it is called otherwise, and somebody else's may be called so."""
    for file in (ROOT / "drivers").rglob("*.py"):
        code = file.read_text(encoding="utf-8")
        named = re.search(r"""^\s*(from|import) drivers\b|["']drivers\.""", code, re.MULTILINE)
        assert named is None, f"{file}: {named and named.group()}"
    assert registry.PACKAGE == "drivers"  # these tests run in the sources
    assert registry.import_driver_module("ptp.doctor").__name__ == "drivers.ptp.doctor"
