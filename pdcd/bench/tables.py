"""The tables of the configuration file as types; `pdcd.bench.config` reads them.

`Config()` with nothing given is the mock bench. Units are in the names.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from pdcd.bench.stops import Stop
from pdcd.panels.placing import Placing
from pdcd.words import (
    ArrangementName,
    BlackLevelName,
    FamilyName,
    GuardsName,
    KeepRawName,
    NormaliseName,
    WindowName,
)

PositiveFloat = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
_Quads = Annotated[int, Meta(ge=1, le=16384)]
Gamma = Annotated[float, Meta(ge=0.1, le=10.0)]
Lut = str | Annotated[tuple[Annotated[float, Meta(ge=0.0, le=1.0)], ...], Meta(max_length=256)]

_Box = tuple[
    Annotated[int, Meta(ge=0)],
    Annotated[int, Meta(ge=0)],
    Annotated[int, Meta(ge=1)],
    Annotated[int, Meta(ge=1)],
]
"""Left, top, width and height in pixels."""

DEFAULT_GRID = (48, 64)
"""Rows and columns of cells when neither the file nor a matrix says otherwise."""

_Homography = tuple[float, float, float, float, float, float, float, float, float]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file: immutable, nothing unknown."""


class RigConfig(_Table, frozen=True):
    """[rig] what holds for the bench as a whole."""

    name: str = "mock bench"
    on_miss: Literal["abort", "balance", "flag"] = "abort"
    """What to do where codes ended with unequal weights: discard the exposure and take it again,
    show codes again in the same exposure until all are equal, or keep it and report the error."""
    retries: Annotated[int, Meta(ge=0, le=100)] = 2
    """How often an exposure is taken again, and how many passes' time one may take longer."""
    settle_s: NonNegative = 0.05
    """Time on black between the shutter being open and the first code, and after the last code."""
    arrangement: ArrangementName = "coaxial"
    """"off-axis": projector and camera look from two places. Direct light then does not come back
    where it fell, but where depth and `plane` say; goals of depth exist only here."""
    plane: _Homography | None = None
    """Off-axis: homography from the camera's field to the projector's, for the plane from which
    disparities are counted. None: the field itself, as calibrated with a card in that plane."""
    look_at_panels: bool = True
    """Whether coded captures take two short photos of random blocks, which show whether both
    panels lie where they are believed to."""
    misregistration_px: NonNegative = 0.0
    """Largest remaining offset between projector and mask, in projector pixels."""
    clock: Literal["virtual", "real"] = "virtual"
    """Whether the mock bench runs as fast as it can, or in real time; real devices are always
    real."""


class PanelConfig(_Table, frozen=True):
    """[projector] or [mask]: one panel, as measured (real) or as it shall behave (mock)."""

    size_px: tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]]
    refresh_hz: PositiveFloat = 60.0
    phase_s: float = 0.0
    """When this panel's vblank falls, relative to the projector's nominal grid."""
    skew_s: float = 0.0
    """Delay from the vblank to the light (negative: the panel leads)."""
    jitter_s: NonNegative = 0.0
    """Standard deviation of that delay, refresh by refresh."""
    scan_s: float = 0.0
    """Time from setting the first row of pixels to setting the last one; negative: the last row
    comes first. The first row to be set has the delay `skew_s`."""
    scan_bands: Annotated[int, Meta(ge=1, le=16384)] = 16
    """Bands of rows that are set together; as many as rows, or more: row by row."""
    rise_s: NonNegative = 0.0
    fall_s: NonNegative = 0.0
    """First-order time constants towards white and towards black."""
    contrast: PositiveFloat | None = None
    """White over black; None is a perfect black."""
    gamma: Gamma | None = None
    """Light of a grey level over full light: (level / 255) to this power. None: unknown; the levels
    that are sent are then taken for light, to the last digit."""
    lut: Lut | None = None
    """The same as a table, used instead of `gamma`: light of evenly spaced levels from 0 to 255,
    the first 0, the last 1; or the path of a text file with them."""
    offset_px: tuple[float, float] = (0.0, 0.0)
    """Mask only: remaining offset of its image from the projector's (right, down), in projector
    pixels: known, but not corrected. `place` corrects."""
    blur_px: Annotated[float, Meta(ge=0.0, le=64.0)] = 0.0
    """Mask only: blur of the scene's light on it, standard deviation of a Gaussian in projector
    pixels."""
    place: Placing = field(default_factory=Placing)
    """Where the panel's pixels lie on the projector's picture, for drawing."""
    field_px: _Box | None = None
    """Projector only: the field, as left, top, width and height in its pixels; a calibration
    measures which part of its picture mask and camera share. None: all of the picture."""

    @property
    def field_box_px(self) -> tuple[int, int, int, int]:
        """For the projector: `field_px`, or the box of its whole picture where that is None."""
        return (0, 0, *self.size_px) if self.field_px is None else self.field_px

    @property
    def field_size_px(self) -> tuple[int, int]:
        """For the projector: width and height of the field in its pixels."""
        return self.field_box_px[2:]


class FaultsConfig(_Table, frozen=True):
    """[display.faults] what the mock panels shall do wrong, by refresh number of an exposure.

    Refreshes are those of the video signal. Further passes of an exposure count on.
    """

    late: dict[str, Annotated[int, Meta(ge=1)]] = field(default_factory=dict)
    """Refresh -> by how many refreshes it comes late (the one before lasts longer)."""
    dropped: tuple[int, ...] = ()
    """Refreshes never shown: the one before is shown in their place."""
    stale_mask: tuple[int, ...] = ()
    """Refreshes at which the mask keeps what it showed while the projector moves on."""
    stale_projector: tuple[int, ...] = ()
    exposures: Annotated[int, Meta(ge=0)] = 0
    """How many exposures have these faults, counted from the first; 0 is all."""


class DisplayConfig(_Table, frozen=True):
    """[display] the driver of both panels."""

    driver: str = "mock"
    mask_delay_refreshes: Annotated[int, Meta(ge=-60, le=60)] = 0
    """Whole refreshes by which the mask is sent its frames later than the projector (negative:
    earlier), to cancel a latency between the panels: -2 for a mask that is 2 refreshes late."""
    planes_per_refresh: Literal[1, 24] = 1
    """24: both panels are DLPs in video-pattern mode and show the 24 bits of each picture in turn,
    so that each refresh of the video signal carries 24 refreshes of a schedule."""
    plane_order: Literal["GRB", "GBR", "RGB", "RBG", "BRG", "BGR"] = "GRB"
    """Colours that hold planes 0-7, 8-15 and 16-23."""
    plane_starts: tuple[Annotated[float, Meta(ge=0.0, lt=1.0)], ...] = ()
    """When each of the 24 planes begins, as a share of a refresh, ascending, as measured; each
    lasts until the next. Empty: all are equally long."""
    row_times: bool = False
    """Whether the panels can be black for any time after each row, like DMDs that show loaded
    patterns by a clock of their own. For the mock panels it says that they can."""
    faults: FaultsConfig = field(default_factory=FaultsConfig)
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def starts(self) -> tuple[float, ...]:
        """When each plane of a refresh begins, as a share of it."""
        count = self.planes_per_refresh
        return self.plane_starts or tuple(plane / count for plane in range(count))

    @property
    def plane_shares(self) -> tuple[float, ...]:
        """How long each plane lasts, as a share of a refresh."""
        starts = self.starts
        ends = (*starts[1:], 1.0 + starts[0])
        return tuple(end - start for start, end in zip(starts, ends, strict=True))


class CameraConfig(_Table, frozen=True):
    """[camera] readout, exposure settings and, for the mock, the sensor."""

    driver: str = "mock"
    profile: str = "modern"
    """Sensor profile: a name below config/sensors, or the path of a TOML file."""
    iso: int | None = None
    """None: the profile's lowest."""
    f_number: PositiveFloat | Literal["auto"] = "auto"
    """"auto" takes test exposures and sets the aperture so that nothing saturates.
    A lens that cannot be set from here needs its own f-number, at which photos are scaled."""
    noise: Literal["none", "full"] = "full"
    quads_per_cell: Annotated[int, Meta(ge=1, le=64)] = 1
    """Mock only: Bayer quads of the frame for each code cell, along either axis."""
    buckets: Literal[1, 2] = 1
    """2: each exposure has two planes, and the second has the light that the mask's patterns keep
    out of the first; for `method = "pairs"`. The mask is part of the sensor, or a mirror that sends
    light two ways."""
    frame_quads: tuple[_Quads, _Quads] | None = None
    """Mock only: width and height of the frame in Bayer quads, whatever the cells; None: computed
    from `quads_per_cell`."""
    responsivity_e: (
        Annotated[tuple[PositiveFloat, ...], Meta(min_length=1, max_length=3)] | None
    ) = None
    """Electrons per scene unit and second at f/1 (R, G, B), or one number for a sensor without
    colours; None: the mock's own."""
    stops: Annotated[tuple[Stop, ...], Meta(max_length=128)] = ()
    """Stops of the lens whose light a calibration compared; others are taken to be 2^(k/6)."""
    place: Placing = field(default_factory=Placing)
    """Where the camera's Bayer quads lie on the field."""
    blur_quads: Annotated[float, Meta(ge=0.0, le=64.0)] = 0.0
    """Standard deviation of the blur between the mask's image and the sensor, in quads."""
    seed: Annotated[int, Meta(ge=0)] = 0
    fetch_timeout_s: PositiveFloat = 60.0
    keep: KeepRawName = "all"
    """RAW files that a run keeps: all of them, that of its last shot, or none. A run without them
    cannot be decoded again. With "none", photos that come as samples never touch the disk."""
    readout_s: NonNegative | None = None
    """Seconds that a photo takes beside its exposure, until its file is stored; None: as observed.
    It decides into how many exposures a plain request is split."""
    options: dict[str, Any] = field(default_factory=dict)


class TriggerConfig(_Table, frozen=True):
    """[trigger] the shutter."""

    driver: str = "mock"
    lag_s: NonNegative = 0.06
    jitter_s: NonNegative = 0.01
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def sure_ns(self) -> int:
        """Time after an order by which the blades have surely obeyed: the lag and four jitters."""
        return round((self.lag_s + 4.0 * self.jitter_s) * 1e9)


class SceneConfig(_Table, frozen=True):
    """[scene] the virtual scene of the mock bench.

    `kind` is a preset name (see `pdcd.virtual.scene.presets`) or "matrix" with `path` to an .npz.
    """

    kind: str = "open-book"
    path: str | None = None
    grid: tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]] | None = None
    """Rows, columns of cells; None: 48 x 64, or the matrix file's own."""
    ambient: NonNegative = 0.0
    """Light that is not the projector's, in scene units."""
    options: dict[str, Any] = field(default_factory=dict)


class ScheduleConfig(_Table, frozen=True):
    """[schedule] defaults of the codes and of their timing."""

    grid: tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]] | Literal["auto"] | None = (
        None
    )
    """Rows and columns of code cells; None: the scene's; "auto": the smallest cells that keep apart
    what a calibration measured."""
    codes: Annotated[int, Meta(ge=1, le=65536)] = 128
    family: FamilyName = "hadamard"
    window: WindowName = "auto"
    guards: bool | GuardsName = True
    black_level: BlackLevelName = "auto"
    normalise: NormaliseName = "auto"

    @property
    def cells(self) -> tuple[int, int] | None:
        """Rows and columns of code cells, where they are typed (`Config.code_grid`)."""
        return None if self.grid == "auto" else self.grid


class BenchConfig(_Table, frozen=True):
    """[bench] what the mock bench really is, where that is not what the rest of the file says."""

    truth: str | None = None
    """File of the truth (`pdcd.bench.truth`); None: the bench is as it is described."""


class CalibrationConfig(_Table, frozen=True):
    """[calibration] which measured values replace typed ones."""

    use: str = "latest"
    """"latest": the newest of this rig in the state folder that fits, unless `pdcd calibrate use`
    named one; "none"; or the path of a folder that `pdcd calibrate` made."""
    keep: tuple[str, ...] = ()
    """Keys that stay as typed whatever was measured: "mask.skew_s"."""
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")] | None = None
    """Digest that the calibration must have; None: any."""
    typed: dict[str, str] = field(default_factory=dict)
    """Written by the program: typed values of devices that measured ones have replaced, by key and
    as JSON. A mock bench goes on being what was typed (`pdcd.bench.truth`)."""
    card_albedo: Annotated[float, Meta(gt=0.05, le=1.0)] | None = None
    """Share of the light on it that the white card reflects, as its maker says: the absolute scale
    of all photos depends on it. None: 0.9, to 5 %."""
    check: Literal["daily", "always", "never"] = "daily"
    """When a capture reminds the user to check the bench first."""
    max_age_days: PositiveFloat = 30.0
    """Age from which on a capture warns of the calibration."""


class LimitsConfig(_Table, frozen=True):
    """[limits] what the daemon refuses to exceed."""

    max_exposure_s: PositiveFloat = 600.0
    min_free_bytes: Annotated[int, Meta(ge=0)] = 256 * 1024 * 1024
    connections: Annotated[int, Meta(ge=1)] = 16
    """Clients at a time. Beyond these, places are kept for root and the daemon's own user."""
    connections_per_user: Annotated[int, Meta(ge=1)] = 8
    queued_per_user: Annotated[int, Meta(ge=1)] = 16
    """Jobs that wait. Root and the daemon's own user are exempt from both limits."""
    idle_s: PositiveFloat = 300.0
    """A client without a job, a subscription or a request is disconnected after this time."""
    work_bytes: Annotated[int, Meta(ge=2**28)] = 4 * 2**30
    """Memory of the process that plans and decodes. A job that cannot fit is refused; one that
    turns out to need more fails."""
    work_silent_s: PositiveFloat = 120.0
    """How long that process may stay without a sign of life before it is killed, and its job
    fails."""


class RoleConfig(_Table, frozen=True):
    """[server.look], [server.shoot] or [server.administer]: who has that role."""

    uids: tuple[int, ...] = ()
    groups: tuple[str | int, ...] = ()
    """By name or number."""


class ServerConfig(_Table, frozen=True):
    """[server] the socket and the state folder."""

    socket: str | None = None
    """None: $RUNTIME_DIRECTORY/../pdcd.sock under systemd, else $XDG_RUNTIME_DIR/pdcd.sock."""
    state_dir: str | None = None
    """None: $STATE_DIRECTORY under systemd, else $XDG_STATE_HOME/pdcd, else ~/.local/state/pdcd."""
    arrays: str | None = None
    """Folder whose arrays requests may name; each client may use those that it can read itself.
    None: no such folder."""
    allow_uids: tuple[int, ...] = ()
    """Users allowed besides the daemon's own, root and the members of its group (by socket mode).
    They may shoot, like those in `shoot.uids`."""
    look: RoleConfig = field(default_factory=RoleConfig)
    """See the rig, its jobs and their events."""
    shoot: RoleConfig = field(default_factory=RoleConfig)
    """Take photos too, and cancel one's own jobs."""
    administer: RoleConfig = field(default_factory=RoleConfig)
    """Cancel everybody's jobs too; root and the daemon's own user always may."""


def _projector() -> PanelConfig:
    return PanelConfig(size_px=(1024, 768))


def _mask() -> PanelConfig:
    return PanelConfig(size_px=(1600, 1200))


class Config(_Table, frozen=True):
    """The whole file."""

    rig: RigConfig = field(default_factory=RigConfig)
    projector: PanelConfig = field(default_factory=_projector)
    mask: PanelConfig = field(default_factory=_mask)
    display: DisplayConfig = field(default_factory=DisplayConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    trigger: TriggerConfig = field(default_factory=TriggerConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    bench: BenchConfig = field(default_factory=BenchConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    server: ServerConfig = field(default_factory=ServerConfig)

    def code_grid(self, of_scene: tuple[int, int] | None = None) -> tuple[int, int]:
        """Rows and columns of code cells: those of the schedule, else of the scene, else the
        default.

        of_scene : grid of the mock scene once it is built, for a matrix file brings its own. All
            code that plans, shows or sees codes gets their cells here.
        """
        return self.schedule.cells or of_scene or self.scene.grid or DEFAULT_GRID

    @property
    def row_hz(self) -> float:
        """Rows of `Frames` shown a second: refreshes of the slower panel, times their planes."""
        slower = min(self.projector.refresh_hz, self.mask.refresh_hz)
        return slower * self.display.planes_per_refresh

    @property
    def mask_delay_rows(self) -> int:
        """The mask's delay in rows of `Frames`."""
        return self.display.mask_delay_refreshes * self.display.planes_per_refresh
