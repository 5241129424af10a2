"""What is done to levels between the frame buffer and a panel, as far as the X server reports it.

Codes are drawn black and white, pixel by pixel. Gamma ramps, colour matrices, a limited range and
scaling come after that, so reading the screen does not show them. Sources: randrproto 1.6; the
properties that the kernel's drivers, xf86-video-amdgpu and NVIDIA's driver give their outputs.
No server reports a night light in a compositor, or what a panel does to its input: `calibrate
light` measures these with the camera.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from pdcd.bench.devices import Finding
from pdcd.presenter.properties import PropertyValue, read_property_values

_Numbers = tuple[float, ...]
_Ramp = tuple[tuple[int, ...], ...]
_State = Literal["warning", "fault"]

_UNIT: _Numbers = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_STRAIGHT = tuple(range(0, 65536, 257))
_SHOWN = 0, 128, 255
"""Levels whose output describes a ramp in words."""
_MOST = 8
"""Most items of a property that are shown."""
_BELOW = 64
"""How much lower, of 65535, a level may come out and still be itself: interpolation rounds."""


class _Row(NamedTuple):
    """A property: its neutral values, the value to set, and what other values do.

    state is that of other values; a value that leaves the choice to the driver is a warning.
    """

    name: str
    neutral: Container[PropertyValue]
    mend: str
    state: _State
    says: str


_LIMITED = "the panel may get levels 16 to 235 for 0 to 255: set its input to the full range, too"
_MOVED = "pixels are not those of the panel"
_DITHERED = "grey levels are mixed by the card"
_DIMMED = "levels change with the picture"
_COLOURED = "colours are changed"
_CHOSEN = {"auto", "Automatic"}
"""Values that leave the choice to the driver."""
_TABLE = (
    _Row("Broadcast RGB", {"Full"}, "Full", "warning", _LIMITED),
    _Row("output_csc", {"bypass"}, "bypass", "warning", _LIMITED),
    _Row("Colorspace", {"Default"}, "Default", "warning", "the panel is told of other colours"),
    _Row("underscan", {"off"}, "off", "fault", _MOVED),
    *(
        _Row(f"{side} margin", {0}, "0", "fault", _MOVED)
        for side in ("left", "right", "top", "bottom")
    ),
    _Row("Border", {0}, "0,0,0,0", "fault", _MOVED),
    _Row("scaling mode", {"None", "Center"}, "Center", "warning", "the card stretches the picture"),
    _Row("max bpc", range(8, 65), "8", "warning", "steps of grey are lost"),
    _Row("dither", {"off"}, "off", "warning", _DITHERED),
    _Row("dithering mode", {"off"}, "off", "warning", _DITHERED),
    _Row("abm level", {0}, "0", "warning", _DIMMED),
    _Row("adaptive backlight modulation", {"off"}, "off", "warning", _DIMMED),
    _Row("vibrant hue", {90}, "90", "warning", _COLOURED),
    _Row("color vibrance", {150}, "150", "warning", _COLOURED),
)
_SCALING = "scaling mode"
_MATRICES = {
    "CTM": "0,1,0,0,0,0,0,0,0,1,0,0,0,0,0,0,0,1",
    "CscMatrix": "65536,0,0,0,0,65536,0,0,0,0,65536,0",
}
"""Colour matrices, each with its neutral value in xrandr's notation."""
_TABLES = ("DEGAMMA_LUT", "GAMMA_LUT")


@dataclass(frozen=True)
class OutputLevels:
    """What one output does to the picture drawn on it, as far as the server reports.

    ramps : by name, "gamma ramp" or a property: what each of 256 levels comes out as in red, green
        and blue, 0 to 65535.
    transform : 3 x 3, row by row, from pixels of the output to those of the screen.
    properties : those of `_TABLE` and of `_MATRICES` that the output has, by name.
    native : the mode is one that the panel prefers, or it is not known which it prefers.
    """

    ramps: tuple[tuple[str, _Ramp], ...] = ()
    transform: _Numbers = _UNIT
    properties: tuple[tuple[str, tuple[PropertyValue, ...]], ...] = ()
    native: bool = True

    def __str__(self) -> str:
        told = [name for name, _ in self.ramps]
        told += [
            f"{name} {_words(values)}" for name, values in self.properties if name not in _MATRICES
        ]
        return ", ".join(told)


def read_levels(
    display: Any, output: int, crtc: int, *, clocked: bool, native: bool = True
) -> OutputLevels:
    """Ask the server for everything it reports of one output that is on; nothing is changed.

    `read_outputs` calls this for every output. On outputs without a pixel clock (`clocked` False,
    Xvfb), a ramp of zeros was never set and is left out. Raises what python-xlib raises.
    """
    ramps: list[tuple[str, _Ramp]] = []
    if display.xrandr_get_crtc_gamma_size(crtc).size > 1:
        found = display.xrandr_get_crtc_gamma(crtc)
        ramp = _spread(found.red, found.green, found.blue)
        if clocked or any(map(any, ramp)):
            ramps.append(("gamma ramp", ramp))
    for name in _TABLES:  # red, green, blue and a spare; one 0 where none is set
        values = [v for v in read_property_values(display, output, name) if isinstance(v, int)]
        if len(values) >= 8:
            ramps.append((name, _spread(values[0::4], values[1::4], values[2::4])))
    matrix = display.xrandr_get_crtc_transform(crtc).current_transform
    transform = tuple(
        _fixed(int(matrix[f"matrix{row}{column}"])) for row in "123" for column in "123"
    )
    names = (*(row.name for row in _TABLE), *_MATRICES)
    told = ((name, read_property_values(display, output, name)) for name in names)
    return OutputLevels(
        tuple(ramps), transform, tuple((name, values) for name, values in told if values), native
    )


def list_level_findings(
    output: str, role: str, levels: OutputLevels, *, exact: bool = False
) -> list[Finding]:
    """Everything about an output that is not neutral, each with the command that mends it; or one
    finding that everything is neutral.

    `doctor display` shows them, and no code is shown while one is a fault. exact : a level carries
    24 bits that are shown one by one, so every level must come out exactly.
    """
    found = [
        *_ramps(output, role, levels, exact=exact),
        *_transform(output, role, levels),
        *_properties(output, role, levels, exact=exact),
        *_matrices(output, role, levels),
    ]
    if found:
        return found
    told = str(levels)
    if not told:
        return [Finding(f"{role} levels", "unknown", f"{output}: the server does not report them")]
    return [Finding(f"{role} levels", "good", f"{output}: as they are drawn ({told})")]


def _ramps(output: str, role: str, levels: OutputLevels, *, exact: bool) -> Iterator[Finding]:
    for name, ramp in levels.ramps:
        if all(part == _STRAIGHT for part in ramp):
            continue
        ends = {(part[0], part[-1]) for part in ramp}
        state: _State = "warning" if ends == {(0, 65535)} and not exact else "fault"
        says = _outcome(ramp, state) if any(map(any, ramp)) else "all 0: the panel stays black"
        mend = _set(output, name, "0") if name in _TABLES else f"{_xrandr(output)} --gamma 1:1:1"
        yield Finding(f"{role} {name}", state, f"{output}: {says}", mend)


def _outcome(ramp: _Ramp, state: _State) -> str:
    """What a ramp does to levels, in words."""
    parts = [", ".join(f"{part[level] / 257.0:.0f}" for level in _SHOWN) for part in ramp]
    came = parts[0]
    if len(set(parts)) > 1:
        came = f"red {parts[0]}; green {parts[1]}; blue {parts[2]}"
    harm = "grey levels give other light than assumed"
    if state == "fault":
        harm = "codes are not shown as they are; a night light or a colour profile sets such ramps"
    return f"levels {', '.join(map(str, _SHOWN))} come out as {came}: {harm}"


def _spread(*channels: Sequence[int]) -> _Ramp:
    """A ramp of any number of steps as the output of each of 256 levels. A level whose output is
    itself in 8 bits becomes 257 times itself, however the driver fills the lower bits."""
    drawn = np.arange(256.0)
    out = []
    for steps in channels:
        came = np.interp(drawn / 255.0, np.linspace(0.0, 1.0, len(steps)), steps)
        itself = (came >= 256.0 * drawn - _BELOW) & (came < 256.0 * (drawn + 1.0))
        out.append(tuple(np.where(itself, 257.0 * drawn, came).round().astype(int).tolist()))
    return tuple(out)


def _transform(output: str, role: str, levels: OutputLevels) -> Iterator[Finding]:
    if levels.transform != _UNIT:
        text = f"{output}: {_rows(levels.transform, 3)}: {_MOVED}"
        yield Finding(f"{role} transform", "fault", text, f"{_xrandr(output)} --transform none")


def _properties(output: str, role: str, levels: OutputLevels, *, exact: bool) -> Iterator[Finding]:
    told = dict(levels.properties)
    for row in _TABLE:
        values = told.get(row.name, ())
        if all(value in row.neutral for value in values) or (
            row.name == _SCALING and levels.native
        ):
            continue
        chosen = _CHOSEN.issuperset(values)
        says = f"the driver chooses; {row.says}" if chosen else row.says
        yield Finding(
            f"{role} {row.name}",
            "warning" if chosen else "fault" if exact else row.state,
            f"{output}: {_words(values)}: {says}",
            _set(output, row.name, row.mend),
        )


def _matrices(output: str, role: str, levels: OutputLevels) -> Iterator[Finding]:
    told = dict(levels.properties)
    for name, unit in _MATRICES.items():
        words = [value for value in told.get(name, ()) if isinstance(value, int)]
        if len(words) < 12:  # one 0 where none is set
            continue
        if name == "CTM":
            pairs = zip(words[::2], words[1::2], strict=False)
            numbers = tuple(_sign_and_size(low + (high << 32)) for low, high in pairs)
            columns = 3
        else:
            numbers, columns = tuple(_fixed(word) for word in words), 4
        if numbers != tuple(float(k // columns == k % columns) for k in range(len(numbers))):
            text = f"{output}: {_rows(numbers, columns)}: colours are mixed, or dimmed"
            yield Finding(f"{role} {name}", "fault", text, _set(output, name, unit))


def _fixed(word: int) -> float:
    """A number of 32 bits in two's complement, 16 of them after the point."""
    return float((word ^ 1 << 31) - (1 << 31)) / (1 << 16)


def _sign_and_size(word: int) -> float:
    """A number of 64 bits, 32 of them after the point, whose highest bit is its sign."""
    size = word & ((1 << 63) - 1)
    return (-size if word >> 63 else size) / (1 << 32)


def _rows(numbers: _Numbers, columns: int) -> str:
    rows = (numbers[k : k + columns] for k in range(0, len(numbers), columns))
    return " / ".join(" ".join(f"{v:.4g}" for v in row) for row in rows)


def _words(values: tuple[PropertyValue, ...]) -> str:
    return ", ".join(str(value) for value in values[:_MOST])


def _xrandr(output: str) -> str:
    return f"xrandr --output {output}"


def _set(output: str, name: str, value: str) -> str:
    quoted = f'"{name}"' if " " in name else name
    return f"{_xrandr(output)} --set {quoted} {value}"
