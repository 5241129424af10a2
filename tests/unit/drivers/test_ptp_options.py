"""Which camera is meant: the options of both roles, checked and put together."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.ptp.options import PtpOptions, read_ptp_options
from drivers.ptp.values import list_f_numbers, list_isos
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
    "wrong", [{"id": "450D"}, {"release": "half"}, {"usb": ""}, {"fast": True}]
)
def test_wrong_options_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"camera\.options"):
        options(wrong, None)


def test_two_roles_that_disagree_are_refused() -> None:
    with pytest.raises(ConfigError, match="one device"):
        options({"serial": "7"}, {"serial": "8"})


def test_the_lists_of_a_450d_in_the_words_of_its_dials() -> None:
    assert list(list_isos((0, 0x48, 0x50, 0x58, 0x60, 0x68))) == [100, 200, 400, 800, 1600]
    assert list_f_numbers((0x3D, 0x0C, 0x0D, 0x38)) == {1.2: 0x0C, 8.0: 0x38, 10.0: 0x3D}
    assert list_f_numbers(()) == {}
