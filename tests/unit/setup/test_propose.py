"""From what was found and said to a configuration, by tables; each is one that `pdcd` takes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from pdcd.bench.config import from_config_tables
from pdcd.bench.reading import format_toml
from pdcd.errors import ConfigError
from pdcd.presenter.outputs import Output
from pdcd.setup.facts import MOCK, OWN_RELEASE, VIRTUAL, BenchChoices, BenchFacts
from pdcd.setup.propose import BenchProposal, suggest_bench, suggest_choices
from tests.unit.setup.bench_facts import (
    ADAPTER,
    BEAMER,
    BOARD,
    EOS,
    FULL_HD,
    LCD,
    OTHER_EOS,
    UXGA,
    VISION,
    bare,
    desk,
)


def proposed(facts: BenchFacts, **typed: str) -> BenchProposal:
    made = suggest_bench(facts, suggest_choices(facts, dict(typed)))
    from_config_tables(made.tables, "proposal")  # which raises for all that is wrong
    assert format_toml(made.tables, made.notes).count("#") == len(made.notes)
    return made


def value(made: BenchProposal, key: str) -> Any:
    found: Any = made.tables
    for name in key.split("."):
        found = found.get(name) if isinstance(found, dict) else None
    return found


@pytest.mark.parametrize(
    ("facts", "typed", "names"),
    [
        (bare(), {}, ("DUMMY1", "DUMMY0")),  # from left to right
        (bare(), {"mask": "DUMMY1"}, ("DUMMY0", "DUMMY1")),
        (desk(), {}, ("HDMI-1", "DP-1")),  # by its name; the laptop's own panel is the last
        (desk(), {"projector": "DP-1"}, ("DP-1", "HDMI-1")),
        (desk(), {"mask": "HDMI-1"}, ("DP-1", "HDMI-1")),
        (BenchFacts(outputs=(LCD,)), {}, ("", "")),
        (BenchFacts(outputs=(LCD,)), {"mask": "DP-1"}, ("", "")),
        (BenchFacts(), {}, ("", "")),
    ],
)
def test_panels_that_are_taken(
    facts: BenchFacts, typed: dict[str, str], names: tuple[str, str]
) -> None:
    chosen = suggest_choices(facts, dict(typed))
    assert (chosen.projector, chosen.mask) == names
    assert (chosen.camera, chosen.release) == (MOCK, OWN_RELEASE)


@pytest.mark.parametrize(
    ("typed", "told"),
    [
        ({"projector": "VGA-1"}, "--projector VGA-1 was not found.*DUMMY1, DUMMY0"),
        ({"projector": "DUMMY1", "mask": "DUMMY1"}, "cannot be both"),
        ({"camera": "04a9:3145"}, "--camera 04a9:3145 was not found.*virtual, none"),
    ],
)
def test_what_is_not_there_is_not_taken(typed: dict[str, str], told: str) -> None:
    with pytest.raises(ConfigError, match=f"(?s){told}"):
        suggest_choices(bare(), dict(typed))


def test_a_bare_server_is_used_as_it_is() -> None:
    made = proposed(bare())
    assert made.modes is None
    assert value(made, "display.options") == {
        "projector": "DUMMY1", "mask": "DUMMY0", "display": ":9",
    }  # fmt: skip
    assert value(made, "projector") == {
        "size_px": [1920, 1080], "refresh_hz": 60.0, "field_px": [240, 0, 1440, 1080],
    }  # fmt: skip
    assert value(made, "mask.size_px") == [1600, 1200] and value(made, "scene.grid") == [60, 80]
    assert value(made, "rig.on_miss") is None
    assert "1440 x 1080 of the projector's 1920 x 1080: the part that has the shape" in made.why[0]
    # The mask fills that part: its corners lie on the field's.
    config = from_config_tables(made.tables, "proposal")
    h = config.mask.place.homography
    assert h is not None
    assert (h[2], h[5]) == (240 / 1920, 0.0)
    assert (h[0] * 1600 + h[2], h[4] * 1200) == pytest.approx((1680 / 1920, 1.0))
    by_processor = proposed(bare(card=False))
    assert value(by_processor, "display.options.allow_software") is True
    assert value(by_processor, "rig.on_miss") == "flag"
    assert any("no graphics card" in text for text in by_processor.left)


def test_a_desk_gets_a_server_with_matched_modes() -> None:
    made = proposed(desk())
    assert made.modes is not None
    assert made.modes.outputs == (BEAMER, LCD) and made.modes.others == ("eDP-1",)
    assert made.modes.timings == (FULL_HD, UXGA)
    # By serial number, where it has one: cables change.
    assert value(made, "display.options") == {"projector": "X4K7", "mask": "77", "display": ":7"}
    assert made.notes["display", "options", "mask"] == "serial number; it is on DP-1"
    twins = desk(outputs=(BEAMER, replace(BEAMER, name="HDMI-2")))
    assert value(proposed(twins), "display.options.projector") == "HDMI-1"


@pytest.mark.parametrize(
    ("mask", "told"),
    [
        (Output("DP-1", True), "DP-1 told no modes: switch the panel on"),
        (replace(LCD, timings=(replace(UXGA, clock_khz=189_000),)), "no modes of one rate"),
    ],
)
def test_modes_that_nobody_can_prove_are_left_to_a_person(mask: Output, told: str) -> None:
    made = proposed(desk(outputs=(BEAMER, mask)))
    assert made.modes is None and any(told in text for text in made.left)
    assert value(made, "projector") is None


@pytest.mark.parametrize(
    ("cameras", "typed", "drivers", "options"),
    [
        ((EOS,), {}, ("ptp", "ptp"), None),
        ((EOS, OTHER_EOS), {}, ("ptp", "ptp"), {"id": "04a9:3145"}),
        ((EOS, OTHER_EOS), {"camera": "04a9:3199"}, ("ptp", "ptp"), {"id": "04a9:3199"}),
        ((VISION, EOS), {}, ("genicam", "genicam"), None),
        ((), {"camera": VIRTUAL}, ("ptp", "ptp"), {"usb": "virtual"}),
        ((EOS,), {"camera": MOCK}, (None, None), None),
        ((), {}, (None, None), None),
        ((EOS,), {"release": ADAPTER.path}, ("ptp", "serial"), None),
    ],
)
def test_cameras_and_what_opens_their_shutter(
    cameras: Any, typed: dict[str, str], drivers: tuple[str | None, str | None], options: Any
) -> None:
    made = proposed(bare(cameras=cameras, ports=(ADAPTER, BOARD)), **typed)
    assert (value(made, "camera.driver"), value(made, "trigger.driver")) == drivers
    assert value(made, "camera.options") == options
    if drivers[0] is None:
        assert any("photos are simulated" in text for text in made.left)
    if drivers[1] == "serial":
        assert made.port == ADAPTER and value(made, "trigger.options.port") == ADAPTER.path
        assert any("RTS" in text and "cameras.md" in text for text in made.plug)
    elif drivers[1] is not None:
        assert any("--release PORT" in text for text in made.why)


def test_a_box_gets_its_bytes_and_a_lens_its_number() -> None:
    chosen = BenchChoices("DUMMY1", "DUMMY0", EOS.key, BOARD.path, "command", "FF01", "FF00", 5.6)
    made = suggest_bench(bare(cameras=(EOS,), ports=(BOARD,)), chosen)
    assert value(made, "trigger.options") == {
        "port": "/dev/ttyS0", "release": "command", "open_hex": "FF01", "close_hex": "FF00",
    }  # fmt: skip
    assert value(made, "camera.f_number") == 5.6


def test_a_machine_with_nothing_gets_the_mock_bench_and_what_to_plug() -> None:
    made = proposed(BenchFacts())
    assert made.tables == {}
    assert "0 outputs are connected" in made.left[0] and "plug in a camera" in made.left[1]
