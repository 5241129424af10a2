"""What a request leaves to the program: in how many exposures its codes are shown.

Four parts or more measure the error of the codes by their spread, and each of them fills the sensor
anew, so that the same codes in the same time leave less noise. What they cost is a RAW file each.
So a plain request gets parts where a RAW file costs little beside the exposure. One that names how
its codes are spent is taken at its word.
"""

from __future__ import annotations

import msgspec

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.codes.hadamard import hadamard_fits
from pdcd.errors import RequestError
from pdcd.frames.lattice import Lattice
from pdcd.frames.schedule import slot_rows
from pdcd.planning.make import schedule_of, window_of
from pdcd.request import CaptureRequest
from pdcd.words import FamilyName

GOALS = ("indirect", "direct")
"""Goals that get parts unasked; others take them when asked."""
NAMED = (
    "codes", "family", "pilot", "parts", "until_error", "repeat", "error", "confidence", "seconds",
    "prior", "smooth", "exposure_s", "method", "illumination",
)  # fmt: skip
"""Fields of which any one says how codes are to be spent: such a request gets what it names."""
FAMILIES: tuple[FamilyName, ...] = ("hadamard", "balanced", "bernoulli", "rademacher")
"""Families whose codes may be split so: any two cells meet equally often."""
PARTS = (8, 4)
"""Numbers of parts that are tried, the better one first. More of them measure no better, and leave
each with fewer codes."""
FEWEST_CODES = 16
"""Codes that a part has at least."""
LITTLE = 0.25
"""Time that all further RAW files may take, over the exposure of the codes."""
READOUT_S = 3.0
"""What a RAW file is taken to cost before a camera of which nothing is known yet."""


def asks_for_camera(request: CaptureRequest) -> bool:
    """Whether the plan of a request depends on what a RAW file costs."""
    return request.parts == "auto" or _plain(request)


def settled(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    camera: CameraInfo | None = None,
    mask_lag_s: float | None = None,
) -> tuple[CaptureRequest, tuple[str, ...]]:
    """The request with its number of parts, and why it is that, a line each.

    `camera` is None where it was not asked yet. Raises RequestError where parts are left to the
    program and go with nothing else that was asked for.
    """
    if not asks_for_camera(request):
        return msgspec.structs.replace(request, parts=request.parts or 1), ()
    if request.error is not None or request.seconds is not None or request.method != "coded":
        raise RequestError(
            "parts are left to the program beside an error, a time or a method",
            hint="give their number, or leave them out",
        )
    parts, reason = _parts(request, config, grid, camera, mask_lag_s)
    return msgspec.structs.replace(request, parts=parts), (f"parts: {reason}",)


def readout_s(config: Config, camera: CameraInfo | None) -> float:
    """Seconds that a RAW file costs beside its exposure: as typed, as the camera was seen to take,
    or as cameras usually do."""
    if config.camera.readout_s is not None:
        return config.camera.readout_s
    told = None if camera is None else camera.readout_s
    return READOUT_S if told is None else told


def _plain(request: CaptureRequest) -> bool:
    if request.goal not in GOALS:
        return False
    usual = CaptureRequest(goal=request.goal)
    return all(getattr(request, name) == getattr(usual, name) for name in NAMED)


def _parts(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    camera: CameraInfo | None,
    mask_lag_s: float | None,
) -> tuple[int, str]:
    """How many parts, and why."""
    if config.camera.noise == "none":
        return 1, "one exposure, as there is no noise that more of them would lower"
    codes = (request.codes or config.schedule.codes) - request.pilot
    family = request.family or config.schedule.family
    fitting = [parts for parts in PARTS if _fits(codes, parts, family)]
    if not fitting:
        return 1, f"one exposure, as {codes} {family} codes cannot be split into four or more"
    schedule = schedule_of(request, config, mask_lag_s)
    fields = Lattice(grid, window_of(request, config, grid)).fields
    coded_s = codes * fields * slot_rows(schedule) / config.row_hz
    # Beside the file, each exposure waits on black before its codes and after them.
    each_s = readout_s(config, camera) + 2.0 * config.rig.settle_s + config.trigger.lag_s
    for parts in fitting:
        more_s = (parts - 1) * each_s
        if more_s <= LITTLE * coded_s:
            return parts, (
                f"{parts} exposures of {codes // parts} codes each, {more_s:.2g} s more in all; "
                "they leave less noise, and their spread measures the error bars"
            )
    return 1, (
        f"one exposure, as {fitting[-1]} would take {(fitting[-1] - 1) * each_s:.2g} s more beside "
        f"{coded_s:.3g} s of codes; the error bars are modelled"
    )


def _fits(codes: int, parts: int, family: FamilyName) -> bool:
    each, rest = divmod(codes, parts)
    if rest or each < FEWEST_CODES or family not in FAMILIES:
        return False
    return hadamard_fits(each, 0.5) if family == "hadamard" else each % 2 == 0
