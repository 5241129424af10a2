"""What a mock bench really is: the file that `[bench] truth` names.

The configuration is what its user believes. The truth says where the bench differs, in the words of
the configuration where there are any. What it leaves out is as typed, even after a calibration has
measured another value: a bench does not change when it is measured. What the words mean:
docs/mock-bench.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, field

from pdcd.bench.grey import curve_of, find_curve_fault, with_lut
from pdcd.bench.reading import (
    ConfigFault,
    find_number_faults,
    make_faults_error,
    merge_table,
    read_toml,
)
from pdcd.bench.stops import Stop
from pdcd.bench.tables import Config, Gamma, Lut, NonNegative, PanelConfig, PositiveFloat
from pdcd.errors import ConfigError
from pdcd.panels.placing import Placing, make_placed_map

_Share = Annotated[float, Meta(ge=0.0, le=1.0)]
_Line = Annotated[int, Meta(ge=0)]
_Level = Annotated[int, Meta(ge=0, le=255)]
_Number = Annotated[int, Meta(ge=1)]
"""Number of an exposure, test exposures included: 1 is the first since the bench was opened."""

TYPED = ("projector", "mask", "camera", "trigger")
"""Tables of devices, whose truth is what was typed. Other tables hold settings, such as
rig.settle_s: a value that a calibration chose there is what the program uses from then on."""
LARGEST_BLUR = 64.0
"""In projector pixels or quads: beyond that there is no picture."""


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file: immutable, nothing unknown."""


class TruePanel(_Table, frozen=True):
    """[projector] or [mask]; None is as typed."""

    phase_s: float | None = None
    skew_s: float | None = None
    jitter_s: NonNegative | None = None
    rise_s: NonNegative | None = None
    fall_s: NonNegative | None = None
    contrast: PositiveFloat | None = None
    offset_px: tuple[float, float] | None = None
    place: Placing | None = None
    gamma: Gamma | None = None
    lut: Lut | None = None
    """Used instead of `gamma`. Where neither is given and nothing was typed, panels are linear."""
    clipped: tuple[_Level, _Level] | None = None
    """Levels that it shows as black and as white: 16 and 235 for one of limited range. Levels
    beyond look like these. This comes before the curve."""
    scan_s: float | None = None
    """Time from setting the first row of pixels to setting the last one; negative: the last row
    comes first."""
    scan_bands: Annotated[int, Meta(ge=1, le=16384)] | None = None
    """Bands of rows that are set together; as many as rows, or more: row by row."""
    falloff: _Share = 0.0
    """Share of the light that is lost in the corners; in between, the loss grows with the square of
    the radius."""
    dead_rows: tuple[_Line, ...] = ()
    dead_columns: tuple[_Line, ...] = ()
    """Lines of pixels that stay black whatever is sent to them."""


class TrueCamera(_Table, frozen=True):
    """[camera]"""

    place: Placing | None = None
    blur_quads: Annotated[float, Meta(ge=0.0, le=LARGEST_BLUR)] | None = None
    """Blur from the mask to the sensor: standard deviation of a Gaussian in quads."""
    falloff: _Share = 0.0
    """Vignetting, as a panel's `falloff`."""
    samples: Annotated[int, Meta(ge=1, le=64)] | None = None
    """Points along either axis of a quad at which the light is sampled; None: as many as a quad has
    pixels of the mask, at least 2 and at most 32."""
    tagged_s: PositiveFloat | None = None
    """Exposure time that the files of all photos give; None: the true one."""


class TrueScene(_Table, frozen=True):
    """[scene]"""

    ambient: NonNegative | None = None
    ambient_from: _Number = 1
    """First exposure with that `ambient`: before it, the ambient light is as the configuration
    says."""
    blur_px: Annotated[float, Meta(ge=0.0, le=LARGEST_BLUR)] | None = None
    """Blur from the scene to the mask: standard deviation of a Gaussian in projector pixels. The
    configuration has it as `mask.blur_px`."""
    blur_taps: Annotated[int, Meta(ge=3, le=15)] = 5
    """Points along either axis at which that Gaussian is sampled; an odd number."""


class _TrueTrigger(_Table, frozen=True):
    """[trigger]"""

    lag_s: NonNegative | None = None
    jitter_s: NonNegative | None = None
    stretched: _Number | None = None
    """Exposure in which the shutter is told late to close, as by a program that was suspended."""
    stretch: Annotated[float, Meta(ge=1.0, le=100.0)] = 1.0
    """Duration of that exposure divided by the duration that was meant."""


class TrueSensor(_Table, frozen=True):
    """[sensor] factors on the profile's own numbers, and what the lens lets through."""

    gain: PositiveFloat = 1.0
    """DN for each electron, relative to the profile."""
    read_noise: PositiveFloat = 1.0
    dark: PositiveFloat = 1.0
    full_well: PositiveFloat = 1.0
    responsivity_e: (
        Annotated[tuple[PositiveFloat, ...], Meta(min_length=1, max_length=3)] | None
    ) = None
    """As `camera.responsivity_e`; None: as typed."""
    stops: tuple[Stop, ...] = ()
    """Light of stops that deviate from 2^(k/6); as `camera.stops`, without sigma."""
    prnu: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.0
    """Standard deviation of the samples' sensitivities, which `camera.seed` fixes."""


class BenchTruth(_Table, frozen=True):
    """The whole file."""

    projector: TruePanel = field(default_factory=TruePanel)
    mask: TruePanel = field(default_factory=TruePanel)
    camera: TrueCamera = field(default_factory=TrueCamera)
    scene: TrueScene = field(default_factory=TrueScene)
    sensor: TrueSensor = field(default_factory=TrueSensor)
    trigger: _TrueTrigger = field(default_factory=_TrueTrigger)

    def of(self, config: Config) -> Config:
        """A configuration that describes the bench as it really is."""
        replace, config = msgspec.structs.replace, restore_typed_values(config)
        camera, scene = config.camera, config.scene
        if self.sensor.responsivity_e is not None:
            camera = replace(camera, responsivity_e=self.sensor.responsivity_e)
        if self.sensor.stops:
            camera = replace(camera, stops=self.sensor.stops)
        if self.camera.place is not None:
            camera = replace(camera, place=self.camera.place)
        if self.camera.blur_quads is not None:
            camera = replace(camera, blur_quads=self.camera.blur_quads)
        if self.scene.ambient is not None:
            scene = replace(scene, ambient=self.scene.ambient)
        lag_s, jitter_s = self.trigger.lag_s, self.trigger.jitter_s
        trigger = replace(
            config.trigger,
            lag_s=config.trigger.lag_s if lag_s is None else lag_s,
            jitter_s=config.trigger.jitter_s if jitter_s is None else jitter_s,
        )
        mask = _panel(config.mask, self.mask)
        if self.scene.blur_px is not None:
            mask = replace(mask, blur_px=self.scene.blur_px)
        return replace(
            config,
            # The scene covers the projector's whole picture, whatever part of it codes fill.
            projector=replace(_panel(config.projector, self.projector), field_px=None),
            mask=mask,
            camera=camera,
            scene=scene,
            trigger=trigger,
        )


def restore_typed_values(config: Config) -> Config:
    """The configuration with the typed values of its devices in place of the measured ones.

    Raises ConfigError for values that cannot be read.
    """
    replace, typed = msgspec.structs.replace, config.calibration.typed
    for table in TYPED if typed else ():
        used = getattr(config, table)
        kinds = {f"{table}.{f.name}": f for f in msgspec.structs.fields(used)}
        try:
            back = {
                kinds[key].name: msgspec.json.decode(text, type=kinds[key].type)
                for key, text in typed.items()
                if key in kinds
            }
        except msgspec.MsgspecError as err:
            raise ConfigError(
                f"calibration.typed: {err}", hint="take it out of the file: the program writes it"
            ) from err
        config = replace(config, **{table: replace(used, **back)})
    return config


def _panel(believed: PanelConfig, true: TruePanel) -> PanelConfig:
    names = {f.name for f in msgspec.structs.fields(believed)}
    said: dict[str, Any] = {
        name: value
        for name, value in msgspec.structs.asdict(true).items()
        if name in names and value is not None
    }
    if true.gamma is not None and true.lut is None:
        said["lut"] = None  # it would take the place of gamma
    panel = msgspec.structs.replace(believed, **said)
    if true.clipped is None:
        return panel
    low, high = true.clipped
    levels = np.arange(256.0)
    curve = curve_of(panel)
    light = levels / 255.0 if curve is None else curve.light
    seen = np.interp(255.0 * (levels - low) / max(high - low, 1), levels, light)
    return msgspec.structs.replace(panel, lut=tuple(seen.tolist()))


def load_bench_truth(config: Config) -> BenchTruth:
    """The truth of a configuration's mock bench; without a file, everything as typed.

    Raises ConfigError naming all faults of the file, one a line.
    """
    if config.bench.truth is None:
        return BenchTruth()
    source = Path(config.bench.truth)
    truth, faults = read_bench_truth(source, config)
    if faults:
        raise make_faults_error(source, [fault.message for fault in faults])
    return truth


def read_bench_truth(source: Path, config: Config) -> tuple[BenchTruth, list[ConfigFault]]:
    """Read the file of a truth, and all its faults; a key with a fault has its default value.

    Raises ConfigError for what is no TOML file.
    """
    table = read_toml(source, "the bench's truth", "mend bench.truth, or remove it")
    faults: list[ConfigFault] = []
    truth = merge_table(BenchTruth(), table, "", faults)
    truth = msgspec.structs.replace(
        truth,
        projector=with_lut(truth.projector, "projector", source.absolute().parent, faults),
        mask=with_lut(truth.mask, "mask", source.absolute().parent, faults),
    )
    known = {key for fault in faults for key in fault.keys}
    faults += [fault for fault in _faults(truth, config) if known.isdisjoint(fault.keys)]
    return truth, faults


def _faults(truth: BenchTruth, config: Config) -> Iterator[ConfigFault]:
    """Yield the faults that the types alone do not exclude."""
    numbers = list(find_number_faults(msgspec.to_builtins(truth), ""))
    yield from numbers
    if numbers:
        return  # the rest would only repeat the same fault
    if truth.scene.blur_taps % 2 == 0:
        yield ConfigFault(("scene.blur_taps",), "scene.blur_taps: must be odd")
    if truth.projector.offset_px is not None:
        yield ConfigFault(
            ("projector.offset_px",),
            "projector.offset_px: the mask is offset against the projector: set mask.offset_px",
        )
    true = truth.of(config)
    for name in ("projector", "mask"):
        yield from _panel_faults(name, getattr(truth, name), getattr(true, name), config)
    if true.camera.frame_quads is not None:
        yield from _place_faults("camera", true.camera.place, true.camera.frame_quads, config)


def _panel_faults(
    name: str, said: TruePanel, panel: PanelConfig, config: Config
) -> Iterator[ConfigFault]:
    width, height = panel.size_px
    for key, lines, end in (
        ("dead_rows", said.dead_rows, height),
        ("dead_columns", said.dead_columns, width),
    ):
        if any(line >= end for line in lines):
            yield ConfigFault((f"{name}.{key}",), f"{name}.{key}: lines are counted 0 to {end - 1}")
    if (fault := find_curve_fault(name, said.lut)) is not None:
        yield fault
    if said.clipped is not None and said.clipped[0] >= said.clipped[1]:
        yield ConfigFault((f"{name}.clipped",), f"{name}.clipped: black lies below white")
    if said.contrast is not None and said.contrast <= 1.0:
        yield ConfigFault((f"{name}.contrast",), f"{name}.contrast: white over black exceeds 1")
    if abs(panel.phase_s) > 1.0 / panel.refresh_hz:
        yield ConfigFault(
            (f"{name}.phase_s",), f"{name}.phase_s: {panel.phase_s} s is more than one refresh"
        )
    if said.scan_s and (fault := find_scan_fault(name, panel, config.rig.settle_s)) is not None:
        yield fault
    yield from _place_faults(name, panel.place, panel.size_px, config)


def find_scan_fault(name: str, panel: PanelConfig, settle_s: float) -> ConfigFault | None:
    """The fault of rows that are not black when the shutter closes; None where they are."""
    if not panel.scan_s or abs(panel.scan_s) + abs(panel.skew_s) <= settle_s:
        return None
    return ConfigFault(
        (f"{name}.scan_s", "rig.settle_s"),
        f"{name}.scan_s: rows that are set {abs(panel.scan_s):g} s apart are not black within "
        f"rig.settle_s = {settle_s:g} s",
    )


def _place_faults(
    name: str, place: Placing, size: tuple[int, int], config: Config
) -> Iterator[ConfigFault]:
    try:
        make_placed_map(place, size, config.projector.size_px, name)
    except ConfigError as err:
        yield ConfigFault((f"{name}.place",), f"{name}.place: {err.message}")
