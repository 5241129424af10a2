"""Options of the PTP drivers, of both roles put together, and settings in the words of dials."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.ptp.options import PtpOptions, read_ptp_options
from drivers.ptp.values import list_f_numbers, list_isos, list_setup_faults
from pdcd.bench.tables import CameraConfig, Config, TriggerConfig
from pdcd.errors import ConfigError


def options(
    camera: dict[str, Any] | None = None, trigger: dict[str, Any] | None = None
) -> PtpOptions:
    """Options of a rig whose camera, trigger or both are this driver."""
    return read_ptp_options(
        Config(
            camera=CameraConfig(driver="mock" if camera is None else "ptp", options=camera or {}),
            trigger=TriggerConfig(
                driver="mock" if trigger is None else "ptp", options=trigger or {}
            ),
        )
    )


def test_nothing_given_means_the_only_canon_there_is() -> None:
    found = options({}, {})
    assert found == PtpOptions() and found.usb_id is None and found.destination == "ram"


def test_it_is_enough_to_say_it_once() -> None:
    assert options({"id": "04A9:3145"}, {}).usb_id == (0x04A9, 0x3145)
    assert options({}, {"serial": "7"}).serial == "7"
    assert options({"serial": "7"}, {"serial": "7"}).serial == "7"


def test_photos_that_nobody_fetches_stay_on_the_card() -> None:
    assert options(None, {}).destination == "card"
    assert options({}, None).destination == "ram"


@pytest.mark.parametrize(
    "wrong",
    [{"id": "450D"}, {"id": "04a9:31455"}, {"id": "04g9:3145"}, {"release": "half"}, {"usb": ""},
     {"fast": True}],
)  # fmt: skip
def test_wrong_options_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"camera\.options"):
        options(wrong, None)


def test_two_roles_that_disagree_are_refused() -> None:
    with pytest.raises(ConfigError, match="one device"):
        options({"serial": "7"}, {"serial": "8"})


def test_the_lists_of_a_450d_in_the_words_of_its_dials() -> None:
    """In the order of their values; what nobody knows is left out."""
    isos = list_isos((0, 0x68, 0x48, 0x50, 0x58, 0x60, 0x99))
    assert list(isos) == [100, 200, 400, 800, 1600] and isos[200] == 0x50
    f_numbers = list_f_numbers((0x3D, 0x38, 0x0C, 0x0D, 0xFF))
    assert f_numbers == {1.2: 0x0C, 8.0: 0x38, 10.0: 0x3D}
    assert list(f_numbers) == [1.2, 8.0, 10.0] and list_f_numbers(()) == {}


@pytest.mark.parametrize(
    ("values", "custom", "words"),
    [
        ({}, {}, None),  # what was not told is not judged
        ({0xD105: 3, 0xD108: 3, 0xD111: 1, 0xD11B: 5}, {0x201: 0}, None),
        ({0xD105: 4}, {}, None),
        ({0xD105: 0}, {}, "mode dial"),
        ({0xD105: 2}, {}, "mode dial"),
        ({0xD108: 0}, {}, "autofocus"),
        ({0xD111: 0}, {}, "battery"),
        ({0xD11B: 0}, {}, "no room on the card: change it"),
        ({}, {0x201: 1}, "noise reduction"),
        ({}, {0x201: 2}, "noise reduction"),
    ],
)
def test_what_is_to_be_changed_is_said(
    values: dict[int, int], custom: dict[int, int], words: str | None
) -> None:
    found = list_setup_faults(values, custom, "card")
    assert len(found) == (words is not None)
    assert words is None or words in found[0]
