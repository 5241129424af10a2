"""What a server tells of levels: what of it is neutral, what else it is, and what mends it."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from Xlib import X, Xatom, error

from pdcd.presenter import levels as levels_module
from pdcd.presenter import properties
from pdcd.presenter.levels import OutputLevels, list_level_findings, read_levels

UNIT = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def ramp_of(light: Callable[[float], float], steps: int = 256) -> tuple[int, ...]:
    return tuple(round(65535 * light(k / (steps - 1))) for k in range(steps))


def found(levels: OutputLevels, **how: bool) -> list[tuple[str, str, str | None]]:
    """What, state and command of each finding."""
    return [(f.what, f.state, f.hint) for f in list_level_findings("DP-1", "mask", levels, **how)]


def with_ramp(*channels: tuple[int, ...], name: str = "gamma ramp") -> OutputLevels:
    return OutputLevels(((name, levels_module._spread(*channels * (3 // len(channels)))),))


def with_property(name: str, *values: int | str, native: bool = True) -> OutputLevels:
    return OutputLevels(properties=((name, values),), native=native)


# Straight ramps as servers and programs write them: 8, 10 and 12 bits, filled up by 0 or by
# themselves, in any number of steps.
STRAIGHT = {
    "i * 257": tuple(k * 257 for k in range(256)),
    "i << 8": tuple(k << 8 for k in range(256)),
    "10 bits << 6": tuple(k << 6 for k in range(1024)),
    "1024 steps": ramp_of(lambda x: x, 1024),
    "4096 steps": ramp_of(lambda x: x, 4096),
    "33 steps": ramp_of(lambda x: x, 33),
    "2 steps": (0, 65535),
}


@pytest.mark.parametrize("ramp", STRAIGHT.values(), ids=list(STRAIGHT))
def test_a_straight_ramp_is_neutral(ramp: tuple[int, ...]) -> None:
    for exact in (False, True):
        assert found(with_ramp(ramp), exact=exact) == [("mask levels", "good", None)]


# Others, with what levels 0, 128 and 255 come out as: worked out by hand.
BENT: dict[str, tuple[tuple[tuple[int, ...], ...], str, str]] = {
    "all 0": ((ramp_of(lambda x: 0.0),), "fault", "all 0: the panel stays black"),
    "half as bright": ((ramp_of(lambda x: 0.5 * x),), "fault", "0, 64, 128:"),
    "limited": ((ramp_of(lambda x: (16 + 219 * x) / 255),), "fault", "16, 126, 235:"),
    "inverted": ((ramp_of(lambda x: 1 - x),), "fault", "255, 127, 0:"),
    "one channel dark": (
        (ramp_of(lambda x: x), ramp_of(lambda x: x), ramp_of(lambda x: 0.0)),
        "fault", "red 0, 128, 255; green 0, 128, 255; blue 0, 0, 0:",
    ),
    "gamma": ((ramp_of(lambda x: x**0.5),), "warning", "0, 181, 255:"),
    "gamma of 1024": ((ramp_of(lambda x: x**2, 1024),), "warning", "0, 64, 255:"),
    "clipped": ((ramp_of(lambda x: min(max((255 * x - 16) / 219, 0), 1)),), "warning", "130, 255:"),
    "one level": ((tuple((k + (k == 77)) * 257 for k in range(256)),), "warning", "0, 128, 255:"),
}  # fmt: skip


@pytest.mark.parametrize(("ramps", "state", "text"), BENT.values(), ids=list(BENT))
def test_a_ramp_that_is_not_straight_is_told_with_what_it_does(
    ramps: tuple[tuple[int, ...], ...], state: str, text: str
) -> None:
    """A fault where black or white are not; where a level is 24 bits, any."""
    (one,) = list_level_findings("DP-1", "mask", with_ramp(*ramps))
    assert (one.what, one.state) == ("mask gamma ramp", state) and text in one.found
    assert one.hint == "xrandr --output DP-1 --gamma 1:1:1"
    (exact,) = list_level_findings("DP-1", "mask", with_ramp(*ramps), exact=True)
    assert exact.state == "fault"


def test_tables_of_a_driver_are_ramps_of_their_own() -> None:
    table = with_ramp(ramp_of(lambda x: x * 0.9, 4096), name="GAMMA_LUT")
    assert found(table) == [("mask GAMMA_LUT", "fault", "xrandr --output DP-1 --set GAMMA_LUT 0")]


SET = "xrandr --output DP-1 --set"
PROPERTIES: list[tuple[OutputLevels, str | None, str | None]] = [
    (with_property("Broadcast RGB", "Full"), None, None),
    (with_property("Broadcast RGB", "Automatic"), "warning", f'{SET} "Broadcast RGB" Full'),
    (with_property("Broadcast RGB", "Limited 16:235"), "warning", f'{SET} "Broadcast RGB" Full'),
    (with_property("output_csc", "bypass"), None, None),
    (with_property("output_csc", "tvrgb"), "warning", f"{SET} output_csc bypass"),
    (with_property("Colorspace", "BT2020_RGB"), "warning", f"{SET} Colorspace Default"),
    (with_property("underscan", "off"), None, None),
    (with_property("underscan", "auto"), "warning", f"{SET} underscan off"),
    (with_property("underscan", "on"), "fault", f"{SET} underscan off"),
    (with_property("left margin", 0), None, None),
    (with_property("bottom margin", 3), "fault", f'{SET} "bottom margin" 0'),
    (with_property("Border", 0, 0, 0, 0), None, None),
    (with_property("Border", 0, 9, 0, 0), "fault", f"{SET} Border 0,0,0,0"),
    (with_property("scaling mode", "Full aspect"), None, None),
    (with_property("scaling mode", "Center", native=False), None, None),
    (
        with_property("scaling mode", "Full", native=False), "warning",
        f'{SET} "scaling mode" Center',
    ),
    (with_property("max bpc", 12), None, None),
    (with_property("max bpc", 6), "warning", f'{SET} "max bpc" 8'),
    (with_property("dither", "on"), "warning", f"{SET} dither off"),
    (with_property("dithering mode", "auto"), "warning", f'{SET} "dithering mode" off'),
    (with_property("abm level", 2), "warning", f'{SET} "abm level" 0'),
    (with_property("CTM", 0), None, None),
    (with_property("CTM", *[0, 1, *[0] * 6] * 2, 0, 1), None, None),
    (
        with_property("CTM", *[0, 1, *[0] * 6] * 2, 1 << 31, 0), "fault",
        f"{SET} CTM 0,1,0,0,0,0,0,0,0,1,0,0,0,0,0,0,0,1",
    ),
    (with_property("CscMatrix", *[65536, 0, 0, 0, 0] * 2, 65536, 0), None, None),
    (
        with_property("CscMatrix", *[65536, 0, 0, 9, 0] * 2, 65536, 0), "fault",
        f"{SET} CscMatrix 65536,0,0,0,0,65536,0,0,0,0,65536,0",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("levels", "state", "mend"), PROPERTIES)
def test_each_property_is_neutral_or_has_its_command(
    levels: OutputLevels, state: str | None, mend: str | None
) -> None:
    ((name, _),) = levels.properties
    told = found(levels)
    if state is not None:
        assert told == [(f"mask {name}", state, mend)]
    else:
        assert all(found_state in ("good", "unknown") for _, found_state, _ in told)


def test_of_levels_that_are_24_bits_none_may_be_another() -> None:
    """What somebody set is a fault then; what is left to the card's driver may still be right."""
    for name, value, state in (
        ("Broadcast RGB", "Limited 16:235", "fault"),
        ("Broadcast RGB", "Automatic", "warning"),
        ("Broadcast RGB", "Full", "good"),
        ("dither", "on", "fault"),
        ("max bpc", 6, "fault"),
    ):
        assert [one[1] for one in found(with_property(name, value), exact=True)] == [state]


def test_a_matrix_is_told_row_by_row() -> None:
    # Red is half of red, less a quarter of green.
    minus = [1 << 30, 1 << 31]
    ctm = with_property("CTM", 1 << 31, 0, *minus, 0, 0, *[0, 0, 0, 1, 0, 0], *[0, 0, 0, 0, 0, 1])
    (one,) = list_level_findings("DP-1", "mask", ctm)
    assert "0.5 -0.25 0 / 0 1 0 / 0 0 1" in one.found


def test_a_scaled_output_is_a_fault() -> None:
    scaled = OutputLevels(transform=(1.25, *UNIT[1:4], 1.25, *UNIT[5:]))
    assert found(scaled) == [("mask transform", "fault", "xrandr --output DP-1 --transform none")]


class Server:
    """A server of one output, number 7 on CRTC 5."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ramp: tuple[int, ...] = (0, 32768, 65535)
        self.matrix = dict.fromkeys(("12", "13", "21", "23", "31", "32"), 0)
        self.matrix |= dict.fromkeys(("11", "22", "33"), 65536)
        self.properties: dict[str, tuple[int, list[int]]] = {}
        self.atoms = {11: "Full", 12: "Limited 16:235"}
        monkeypatch.setattr(properties, "_GetOutputProperty", self.property)
        self.display = SimpleNamespace(get_extension_major=lambda name: 140)

    def xrandr_get_crtc_gamma_size(self, crtc: int) -> Any:
        assert crtc == 5
        return SimpleNamespace(size=len(self.ramp))

    def xrandr_get_crtc_gamma(self, crtc: int) -> Any:
        return SimpleNamespace(red=self.ramp, green=self.ramp, blue=self.ramp)

    def xrandr_get_crtc_transform(self, crtc: int) -> Any:
        named = {f"matrix{place}": value for place, value in self.matrix.items()}
        return SimpleNamespace(current_transform=named)

    def intern_atom(self, name: str, only: bool) -> Any:
        assert only
        return name if name in self.properties else X.NONE

    def get_atom_name(self, atom: int) -> str:
        if atom not in self.atoms:
            raise error.BadAtom.__new__(error.BadAtom)
        return self.atoms[atom]

    def property(self, *, output: int, property: str, **_: Any) -> Any:
        assert output == 7
        kind, items = self.properties[property]
        return SimpleNamespace(property_type=kind, value=(32, items) if items else None)

    def read(self, **how: bool) -> OutputLevels:
        return read_levels(self, 7, 5, **{"clocked": True, **how})


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    return Server(monkeypatch)


def test_all_that_a_server_tells_is_read(server: Server) -> None:
    server.matrix |= {"11": 81920, "13": 2**32 - 65536}
    server.properties = {
        "Broadcast RGB": (Xatom.ATOM, [12]), "underscan": (Xatom.ATOM, [99]), "dither": (4, []),
        "max bpc": (Xatom.INTEGER, [8]), "DEGAMMA_LUT": (Xatom.INTEGER, [0]),
        "GAMMA_LUT": (Xatom.INTEGER, [0, 0, 0, 9, 255, 510, 765, 9]),
    }  # fmt: skip
    table = tuple(range(256)), tuple(range(0, 512, 2)), tuple(range(0, 768, 3))
    assert server.read(native=False) == OutputLevels(
        (("gamma ramp", (tuple(range(0, 65536, 257)),) * 3), ("GAMMA_LUT", table)),
        (1.25, 0.0, -1.0, *UNIT[3:]),
        (("Broadcast RGB", ("Limited 16:235",)), ("underscan", ("?",)), ("max bpc", (8,))),
        native=False,
    )


def test_a_ramp_that_was_never_set_tells_nothing(server: Server) -> None:
    """A server without hardware has one of nothing but 0; none at all is of size 0."""
    server.ramp = (0, 0, 0)
    assert server.read(clocked=False) == OutputLevels()
    assert found(server.read(clocked=False)) == [("mask levels", "unknown", None)]
    assert found(server.read()) == [
        ("mask gamma ramp", "fault", "xrandr --output DP-1 --gamma 1:1:1")
    ]
    server.ramp = ()
    assert server.read() == OutputLevels()
