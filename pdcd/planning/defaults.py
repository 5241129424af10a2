"""What a request leaves to the program: a look for sharp paths, and in how many exposures its codes
are shown.

A few of the codes, photographed one by one, show whether there are mirrors; if so, a pilot's paths
guide the codes. Four parts or more measure the error of the codes by their spread. Each of them
fills the sensor anew, so that the same codes in the same time leave less noise. Both cost RAW
files. So a request that names neither gets them where a file costs little compared with the
exposure, however many codes it names and of which family; a pilot of 0, or 1 part, switches them
off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.codes.hadamard import can_make_hadamard_codes
from pdcd.codes.pilot.codes import SCOUTS, choose_pilot_count
from pdcd.codes.pilot.matching import MOST_MATCHING_CELLS
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.planning.bench_fit import resolve_window
from pdcd.planning.schedule_fit import RANGES, resolve_slot
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.parts import FEWEST_PARTS
from pdcd.recipes.programs import LongRangeProgram
from pdcd.words import FamilyName

_GOALS = ("indirect", "direct")
"""Goals that get parts and a pilot unasked; others take them when asked. `RANGES` get a pilot and
`FEWEST_PARTS`, as more parts would leave codes too dense for the radius."""
_PARTED = (
    "fraction", "split", "diagonal", "warped", "two-samples", "descattered", "filtered",
)  # fmt: skip
"""Goals that get parts alone unasked."""
_SPENT = (
    "until_error", "repeat", "error", "confidence", "seconds", "prior", "exposure_s", "method",
    "equal_brightness", "codes_from",
)  # fmt: skip
"""Fields of which any one decides how exposures are spent: such a request gets what it names."""
_NAMED = (*_SPENT, "codes", "family", "pilot", "parts", "smooth")
"""Fields that decide what is shown in all: a request with none of these may get more light."""
_CHOSEN = ("codes", "codes_from", "exposure_s", "pilot", "repeat", "equal_brightness")
"""Fields that follow from the error or the time and cannot be given together with it."""
_FAR_LEFT = 0.75
"""Least weight of far light with codes in four parts, over that in one exposure: cells are lit in
at least one code of each part, which for a large radius is too often."""
_FAMILIES: tuple[FamilyName, ...] = ("hadamard", "balanced", "bernoulli", "rademacher")
"""Families whose codes may be split so: any two cells meet equally often."""
_PARTS = (8, 7, 6, 5, 4)
"""Numbers of parts that are tried, the better ones first. More parts measure no better, and have
fewer codes each."""
_FEWEST_CODES = 16
"""Least number of codes of a part."""
_LEFT_OUT = 8
"""Of so many codes one may be left out, so that the others can be split evenly."""
_LITTLE = 0.25
"""Most time for the files of all further parts, over the exposure of the codes."""
_LOOK = 1.0
"""The same for the first photos of a pilot: what they may find is worth more than less noise."""
_FEWEST = 64
"""Least number of codes of which four are spent on a look: with fewer, those four are missed."""
_READOUT_S = 3.0
"""Seconds that a RAW file is taken to cost where nothing is known of the camera yet."""


@dataclass(frozen=True)
class Defaults:
    """A request with its pilot and its parts, and the reasons, a line each.

    otherwise : the request to follow instead when the first photos of a pilot that nobody asked for
        show no sharp paths; None where there is no such pilot.
    """

    request: CaptureRequest
    reasons: tuple[str, ...] = ()
    otherwise: CaptureRequest | None = None


def is_search_needed(request: CaptureRequest) -> bool:
    """Whether a request leaves its parameters to a search (`pdcd.planning.choose`). Raises
    RequestError when it contradicts itself."""
    asked = [name for name in ("error", "seconds") if getattr(request, name) is not None]
    if not asked:
        if request.confidence is not None:
            raise RequestError(
                "confidence goes with a wanted error only",
                hint="give an error, or seconds, and leave the number of codes open",
            )
        return False
    if len(asked) == 2:
        raise RequestError(
            "an error and a time are both asked for",
            hint="give only one; the plan says what the other will be",
        )
    defaults = CaptureRequest(goal=request.goal)
    given = [
        name
        for name in _CHOSEN
        if getattr(request, name) != getattr(defaults, name) and getattr(request, name) != 0
    ]
    given += ["parts"] if request.parts == "auto" else []
    if given:
        raise RequestError(
            f"{' and '.join(given)} and {asked[0]} are both asked for",
            hint=f"{asked[0]} decides on codes, pilot, exposure and repetitions: leave them out",
        )
    if request.goal == "transport":
        raise RequestError(
            f"{asked[0]} is about the picture of a goal, and that of transport is not its entries",
            hint=f"leave out {asked[0]}; repeat takes each photo more than once",
        )
    if request.method != "coded" or request.family in ("isolation", "confocal"):
        raise RequestError(
            f"{asked[0]} is for coded photos",
            hint="leave method and family out",
        )
    return True


def can_split_codes(family: FamilyName, count: int) -> bool:
    """Whether parts of so many codes measure the error of their codes."""
    return family in _FAMILIES and count >= _FEWEST_CODES


def is_camera_needed(request: CaptureRequest) -> bool:
    """Whether the plan of a request depends on the time that a RAW file costs."""
    return "auto" in (request.parts, request.pilot) or "auto" in _left_open(request)


def can_average(request: CaptureRequest, config: Config) -> bool:
    """Whether everything may be shown more often against the noise of ambient light."""
    plain = _names_none(request, _NAMED)
    return plain and request.goal in _GOALS and config.camera.noise != "none"


def resolve_defaults(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    camera: CameraInfo | None = None,
    mask_lag_s: float | None = None,
) -> Defaults:
    """What a request leaves open, resolved.

    `camera` is None where it is not known yet. Raises RequestError where parts or a pilot are left
    to the program together with something that excludes it.
    """
    pilot, parts = _left_open(request)
    bare = msgspec.structs.replace(
        request,
        parts=parts if isinstance(parts, int) else 1,
        pilot=pilot if isinstance(pilot, int) else 0,
    )
    if "auto" not in (pilot, parts):
        return Defaults(bare)
    if request.error is not None or request.seconds is not None or request.method != "coded":
        raise RequestError(
            "parts or a pilot are left to the program beside an error, a time or a method",
            hint="give their number, or leave them out",
        )
    costs = _costs(bare, config, grid, camera, mask_lag_s)
    if pilot != "auto":
        return _without_pilot(bare, config, costs, parts=True)
    open_parts = parts == "auto"
    why = _no_pilot(request, grid, costs, parts)
    if why:
        found = _without_pilot(bare, config, costs, parts=open_parts)
        return replace(found, reasons=(f"pilot: none, {why}", *found.reasons))
    return _with_pilot(bare, config, costs, parts=open_parts)


def readout_s(config: Config, camera: CameraInfo | None) -> float:
    """Seconds that a RAW file costs in addition to its exposure: as typed, as measured with this
    camera, or as cameras usually take."""
    if config.camera.readout_s is not None:
        return config.camera.readout_s
    told = None if camera is None else camera.readout_s
    return _READOUT_S if told is None else told


def _left_open(request: CaptureRequest) -> tuple[int | str, int | str]:
    """Pilot and parts of a request: their number, or "auto" where the program decides."""
    fits = request.goal in (*_GOALS, *RANGES, *_PARTED) and request.family in (None, *_FAMILIES)
    usual: int | str = "auto" if fits and _names_none(request, _SPENT) else 0
    pilot = usual if request.pilot is None else request.pilot
    parts = (usual or 1) if request.parts is None else request.parts
    return pilot, parts


def _names_none(request: CaptureRequest, names: tuple[str, ...]) -> bool:
    """Whether a request names none of these fields."""
    usual = CaptureRequest(goal=request.goal)
    return all(getattr(request, name) == getattr(usual, name) for name in names)


@dataclass(frozen=True)
class _Costs:
    """What decides on parts: the number of codes and their family; seconds of their exposure, and
    of one more RAW file; numbers of parts to try; the radius beyond which far light is wanted, None
    where none is asked for; and the share of codes in which a cell is lit, where that is chosen."""

    codes: int
    family: FamilyName
    coded_s: float
    file_s: float
    tried: tuple[int, ...] = _PARTS
    radius: int | None = None
    p: float = 0.5
    far_alone: bool = False
    """Whether there are no other codes."""
    elsewhere: bool = False
    """Whether cells are matched with others than themselves."""

    def parts(self, codes: int) -> int:
        """Most parts in which so many codes can be shown at little cost, each with enough codes;
        1 where that is less than four."""
        for parts in self.tried:
            cheap = (parts - 1) * self.file_s <= self.most_s
            if cheap and self.fits(codes, parts) and self.far_enough(codes, parts):
                return parts
        return 1

    def split(self, codes: int) -> tuple[int, int]:
        """How many of so many codes are shown, and in how many parts: all of them, or a few less
        where all cannot be split evenly; all in one part where no number can."""
        for count in range(codes, codes - codes // _LEFT_OUT - 1, -1):
            parts = self.parts(count)
            if parts > 1:
                return count, parts
        return codes, 1

    def fits(self, codes: int, parts: int) -> bool:
        """Whether so many parts have enough codes of their own each."""
        each, rest = divmod(codes, parts)
        if rest or each < _FEWEST_CODES or self.family not in _FAMILIES:
            return False
        return self.whole(each)

    def whole(self, codes: int) -> bool:
        """Whether a set of so many codes exists: for far light alone any number does."""
        if self.far_alone:
            return True
        if self.p != 0.5:  # balanced codes
            return codes % 2 == 0 and (self.p * codes).is_integer() and self.p * codes >= 1.0
        return can_make_hadamard_codes(codes, 0.5) if self.family == "hadamard" else codes % 2 == 0

    def far_enough(self, codes: int, parts: int) -> bool:
        """Whether codes in so many parts keep nearly as much far light as in one exposure."""
        if self.radius is None:
            return True
        whole, split = (_far_weight(count, self.radius) for count in (codes, codes // parts))
        return split >= _FAR_LEFT * whole

    @property
    def most_s(self) -> float:
        """Time that the files of further parts may take."""
        return _LITTLE * self.coded_s


def _costs(
    request: CaptureRequest,
    config: Config,
    grid: tuple[int, int],
    camera: CameraInfo | None,
    mask_lag_s: float | None,
) -> _Costs:
    codes = request.codes or config.schedule.codes
    far_alone = request.goal == "long-range" and bool(request.radius)
    window = "whole" if far_alone else resolve_window(request, config, grid)
    fields = Lattice(grid, window).fields
    slot_s = resolve_slot(request, config, mask_lag_s).slot_s
    # Besides its file, each exposure has black before its codes and after them.
    more_s = 2.0 * config.rig.settle_s + config.trigger.lag_s
    return _Costs(
        codes=codes,
        family=request.family or config.schedule.family,
        coded_s=codes * fields * slot_s,
        file_s=readout_s(config, camera) + more_s,
        tried=(FEWEST_PARTS,) if request.goal in RANGES else _PARTS,
        radius=request.radius if request.goal in RANGES else None,
        p=request.p if request.p is not None and request.goal == "fraction" else 0.5,
        far_alone=far_alone,
        elsewhere=_elsewhere(request),
    )


def _far_weight(codes: int, radius: int) -> float:
    """Weight of far light in a photo of so many codes (`pdcd.recipes.programs.LongRangeProgram`),
    if cells are lit in the share of codes nearest to the best one (`pdcd.planning.pairs`)."""
    p = LongRangeProgram(radius).p
    lit = max(1, round(p * codes)) / codes
    return float(lit * (1.0 - lit) ** round(1.0 / p - 1.0))


def _without_pilot(
    request: CaptureRequest, config: Config, costs: _Costs, *, parts: bool
) -> Defaults:
    """Parts alone, where they are left open."""
    if not parts:
        return Defaults(request)
    pilot = request.pilot if isinstance(request.pilot, int) else 0
    used, count, reason = _parts(costs.codes - pilot, config, costs)
    codes = request.codes if used + pilot == costs.codes else used + pilot
    made = msgspec.structs.replace(request, codes=codes, parts=count)
    return Defaults(made, (f"parts: {reason}",))


def _with_pilot(request: CaptureRequest, config: Config, costs: _Costs, *, parts: bool) -> Defaults:
    """A short pilot, and what is done instead when its scouts show nothing."""
    named = request.parts if isinstance(request.parts, int) else 1
    share = choose_pilot_count(costs.codes, named)
    left, used = costs.codes - SCOUTS, costs.codes - share
    counts = [n for n in range(left, used - 1, -1) if not n % named and costs.whole(n // named)]
    first, reason = named, "one exposure" if named == 1 else f"{named} exposures, as asked for"
    if parts:
        used, first, reason = _parts(used, config, costs)
        split = [n for n in range(left, used - 1, -1) if costs.parts(n) > 1]
        counts = split if split and first > 1 else counts
    if not counts:
        counts = [used]
    second = costs.parts(counts[0]) if parts and first > 1 else first
    told = (
        f"pilot: {SCOUTS} photos of single codes look for mirrors, {SCOUTS * costs.file_s:.2g} s "
        f"for their files; where they see sharp light {share - SCOUTS} more map it",
        f"parts: {reason}; {second} of {counts[0] // second} where there are no mirrors",
    )
    replaced = msgspec.structs.replace
    return Defaults(
        replaced(request, codes=used + share, pilot=share, parts=first),
        told,
        replaced(request, codes=counts[0] + SCOUTS, pilot=SCOUTS, parts=second),
    )


def _elsewhere(request: CaptureRequest) -> bool:
    """Whether a goal that could keep each cell's own light keeps that of other cells instead."""
    matched = request.shift is not None or request.warp is not None
    return matched and request.goal in (*_GOALS, "fraction", "split")


def _no_pilot(
    request: CaptureRequest, grid: tuple[int, int], costs: _Costs, parts: int | str
) -> str:
    """Why there is no pilot where one is left to the program; nothing where there is one. parts :
    that are asked for, or "auto"."""
    cells = grid[0] * grid[1]
    look_s = SCOUTS * costs.file_s
    fits = request.goal in (*_GOALS, *RANGES) and costs.family == "hadamard"
    if not fits or request.prior is not None:
        return "as it helps indirect, direct, far and near light, with hadamard codes and no prior"
    if costs.elsewhere:
        return "as it looks for paths beside those of each cell with itself"
    named = parts if isinstance(parts, int) else 1
    share = choose_pilot_count(costs.codes, named)
    few = named > 1 and costs.codes - share < named * _FEWEST_CODES
    if costs.codes < _FEWEST or not share or few:
        within = f" in {named} parts" * (named > 1)
        return f"as {costs.codes} codes{within} are too few to spend some on a look"
    if cells > MOST_MATCHING_CELLS:
        return f"as it maps at most {MOST_MATCHING_CELLS} cells and there are {cells}"
    if look_s > _LOOK * costs.coded_s:
        return (
            f"as a look with {SCOUTS} photos would take {look_s:.2g} s for their files beside "
            f"{costs.coded_s:.3g} s of codes"
        )
    return ""


def _parts(codes: int, config: Config, costs: _Costs) -> tuple[int, int, str]:
    """How many of so many codes are shown, in how many parts, and why."""
    if config.camera.noise == "none":
        return codes, 1, "one exposure, as there is no noise that more of them would lower"
    if costs.elsewhere:
        return codes, 1, "one exposure, as fewer codes each would keep direct light apart less well"
    used, parts = costs.split(codes)
    if parts > 1:
        few = f", {codes - used} of {codes} being left out" * (used < codes)
        text = (
            f"{parts} exposures of {used // parts} codes each{few}, "
            f"{(parts - 1) * costs.file_s:.2g} s more in all; they leave less noise, and their "
            "spread measures the error bars"
        )
        return used, parts, text
    why = _one_exposure(codes, costs)
    return codes, 1, f"one exposure, as {why}; the error of the codes is not in the error bars"


def _one_exposure(codes: int, costs: _Costs) -> str:
    """Why codes are not split."""
    few = codes - codes // _LEFT_OUT
    found = [
        (count, parts)
        for count in range(codes, few - 1, -1)
        for parts in costs.tried
        if costs.fits(count, parts)
    ]
    if not found:
        return f"{codes} {costs.family} codes cannot be split into four or more"
    count, parts = min(found, key=lambda one: one[1])
    if not costs.far_enough(count, parts):
        return (
            f"each of {parts} with {count // parts} codes would keep too little light from beyond "
            f"{costs.radius} cells"
        )
    return (
        f"{parts} would take {(parts - 1) * costs.file_s:.2g} s more beside {costs.coded_s:.3g} s "
        "of codes"
    )
