"""`pdcd config check` tries what a configuration names, and reports all that is wrong with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench import registry
from pdcd.bench.devices import DriverContext
from pdcd.cli.main import main
from tests.places import ROOT

Check = Callable[[str], list[str]]


@pytest.fixture
def check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Check:
    """Faults that the command prints for a file of that text; none where it says "sound"."""

    def lines(text: str) -> list[str]:
        path = tmp_path / "rig.toml"
        path.write_text(text)
        code = main(["config", "check", "--config", str(path)])
        printed = capsys.readouterr()
        if code == 0:
            assert (printed.out, printed.err) == (f"sound: {path}\n", "")
            return []
        assert code == 2 and printed.out == ""
        count, *faults = printed.err.splitlines()
        assert count.startswith(f"pdcd: {len(faults)} fault") and count.endswith(f"in {path}:")
        return [fault.strip() for fault in faults]

    return lines


MATRIX = "[scene]\nkind = 'matrix'\npath = 'scene.npz'\n"


@pytest.mark.parametrize(
    ("text", "starts", "says"),
    [
        ("[scene]\nkind = 'opn-book'", "[scene] kind: unknown kind", "open-book"),
        ("[scene]\noptions = {sead = 1}", "[scene] options", "sead"),
        ("[display]\ndriver = 'x12'", "display.driver: no driver is called 'x12'", "x11"),
        ("[trigger]\ndriver = 'ptpp'", "trigger.driver: no driver is called", "serial"),
        ("[camera]\ndriver = 'nikon'", "camera.driver: no driver is called", "gphoto2"),
        ("[camera]\nprofile = 'leica'", "camera.profile: unknown sensor profile", "mark2"),
        ("[camera]\nprofile = 'gone.toml'", "camera.profile: cannot read", "gone.toml"),
        ("[camera]\niso = 77", "camera.iso: sensor profile 'modern' has no ISO 77", "100"),
        ("[schedule]\ncodes = 3", "schedule: hadamard codes do not come", "2 or 4"),
        ("[schedule]\ncodes = 60000", "schedule: the plan needs an exposure", "limit"),
        ("[mask]\nrefresh_hz = 50", "mask.refresh_hz: 50.0 differs", "lockstep"),
        ("[camera.options]\nusb = 'virtual'", "[camera.options] usb: the driver mock", "remove"),
        ("[display]\ndriver = 'x11'\n[rig]\nclock = 'real'", "[display.options] projector",
         "given"),
        ("[trigger]\ndriver = 'serial'\noptions = {port = '/dev/ttyS0'}", "trigger.driver: a real "
         "port", "virtual clock"),
        ("[camera]\ndriver = 'ptp'\noptions = {sreial = '1'}", "[camera.options] sreial", "serial"),
        ("[camera.place]\noffset_px = [3000.0, 0.0]", "camera.place: the map of the camera",
         "beside the field"),
        ("[camera.place]\nradial = [-3.0, 0.0]", "camera.place: the map of the camera", "folds"),
        ("[camera]\ndriver = 'ptp'\nprofile = '450d'\nplace = {scale = 0.4}\n"
         "options = {usb = 'virtual'}",
         "camera.place: the camera's frame of 2145 x 1428", "16.9 %"),
    ],
)  # fmt: skip
def test_a_fault_that_only_trying_shows(check: Check, text: str, starts: str, says: str) -> None:
    first, *more = check(text)
    assert first.startswith(starts) and says in first
    assert all(line.startswith("[display.options]") for line in more)  # x11 must be given two


def test_all_faults_are_told_together(check: Check) -> None:
    found = check(
        "[rig]\nnane = 'x'\n[scene]\nkind = 'opn-book'\n[display]\ndriver = 'x12'\n"
        "[camera]\ndriver = 'nikon'\niso = 77\n[trigger]\ndriver = 'serial'\n"
        "options = {prt = 'x'}\n[mask]\nrefresh_hz = 50\n[schedule]\ncodes = 3\n"
    )
    # Rates first: before a driver that is not the mock's they are a fault of the file itself.
    assert [line.split(":")[0] for line in found] == [
        "rig.nane", "mask.refresh_hz", "[scene] kind", "camera.iso", "display.driver",
        "[trigger.options] prt", "[trigger.options] port", "camera.driver", "schedule",
    ]  # fmt: skip


@pytest.mark.parametrize("shape", [(12, 12), (15, 12), (15,)])
def test_a_matrix_that_does_not_fit_its_grid(
    check: Check, tmp_path: Path, shape: tuple[int, ...]
) -> None:
    np.savez(tmp_path / "scene.npz", transport=np.ones(shape), grid=[3, 5])
    (line,) = check(MATRIX)  # once, though three drivers of the mock bench need the scene
    assert f"`transport` has shape {shape}" in line and "3 x 5" in line


def test_a_matrix_that_is_not_there(check: Check) -> None:
    (line,) = check(MATRIX)
    assert line.startswith("scene.path: there is no file")


def test_a_matrix_that_fits_is_sound(check: Check, tmp_path: Path) -> None:
    np.savez(tmp_path / "scene.npz", transport=np.eye(15), grid=[3, 5])
    assert check(MATRIX) == []


def test_what_could_not_be_read_is_no_second_fault(check: Check) -> None:
    """The clock stands at its default then, which a serial port would refuse."""
    text = "[rig]\nclock = 5\n[trigger]\ndriver = 'serial'\noptions = {port = '/dev/ttyS0'}\n"
    (line,) = check(text)
    assert line.startswith("rig.clock: ")
    (line,) = check("[schedule]\ncodes = 'three'\n")
    assert line.startswith("schedule.codes: ")


def test_a_driver_that_raises_anything_is_a_fault(
    check: Check, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Broken:
        maturity = "broken"

        @classmethod
        def create(cls, context: DriverContext) -> None:
            raise RuntimeError("no licence")

    target = {**registry.DRIVERS, ("display", "broken"): f"{__name__}:Broken"}
    monkeypatch.setattr(registry, "DRIVERS", target)
    monkeypatch.setitem(globals(), "Broken", Broken)
    assert check("[display]\ndriver = 'broken'\n") == ["display.driver: RuntimeError: no licence"]


@pytest.mark.parametrize("name", ["mock.toml", "bench.toml"])
def test_the_examples_are_sound(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Also that of a real rig, of which no device is here: nothing was opened."""
    assert main(["config", "check", "--config", str(ROOT / "config" / name)]) == 0
    assert capsys.readouterr().err == ""
