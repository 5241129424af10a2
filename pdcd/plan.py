"""Request + rig -> a plan: codes, shots, refreshes, seconds, light; nothing is run here."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pdcd.codes import Codes, make_codes
from pdcd.config import Config
from pdcd.errors import ConfigError
from pdcd.goals import WHITE, goal
from pdcd.interfaces import Frames
from pdcd.lattice import Lattice
from pdcd.recipe import Recipe, Shot, make_recipe
from pdcd.request import BlackLevel, CaptureRequest, PlanSummary, ShotSummary
from pdcd.schedule import GUARDED_REFRESHES, build_frames, choose_window


@dataclass(frozen=True)
class Plan:
    """All that the engine needs to know; `frames` builds the refreshes of a shot on demand."""

    recipe: Recipe
    codes: Codes | None
    family: str
    count: int
    p: float
    grid: tuple[int, int]
    window: str
    guards: bool
    passes: int
    white_slots: int
    refresh_hz: float
    settle_s: float

    def frames(self, shot: Shot, *, codes: int | None = None) -> Frames:
        """Refreshes of a shot; `codes` limits it to that many codes, once (test exposures)."""
        shown = self.codes if shot.coded else None
        passes = self.passes if shot.coded else self.white_slots
        if codes is not None:
            passes = 1
            if shown is not None:
                shown = replace(
                    shown,
                    primal_bits=shown.primal_bits[:codes],
                    dual_bits=shown.dual_bits[:codes],
                    weight=shown.weight[:codes],
                )
        return build_frames(
            shown,
            self.grid,
            window=self.window,
            guards=self.guards,
            passes=passes,
            primal=shot.primal,
            dual=shot.dual,
        )

    def refreshes(self, shot: Shot) -> int:
        """Number of refreshes of a shot, without building them."""
        slots = self.white_slots
        if shot.coded:
            slots = self.count * self.passes * Lattice(self.grid, self.window).fields
        return slots * (GUARDED_REFRESHES if self.guards else 1)

    def light_share(self, shot: Shot) -> float:
        """Share of a floodlit exposure of the same length that an off-diagonal path keeps."""
        duty = 1.0 / (GUARDED_REFRESHES if self.guards else 1)
        if "black" in (shot.primal, shot.dual):
            return 0.0
        if not shot.coded:
            return duty
        p = self.p
        kept = p * (1.0 - p) if self.recipe.dual == "complement" else p * p
        return duty * kept / Lattice(self.grid, self.window).fields

    def exposure_s(self, shot: Shot) -> float:
        """Planned time between opening and closing the shutter."""
        return self.refreshes(shot) / self.refresh_hz + 2.0 * self.settle_s

    def summary(self) -> PlanSummary:
        """The plan in figures."""
        shots = tuple(
            ShotSummary(
                name=s.name,
                codes=self.count if s.coded else 0,
                refreshes=self.refreshes(s),
                exposure_s=self.exposure_s(s),
                light_share=self.light_share(s),
            )
            for s in self.recipe.shots
        )
        main = self.recipe.answer[-1][1]
        return PlanSummary(
            goal=self.recipe.goal.name,
            family=self.family,
            codes=self.count,
            p=self.p,
            grid=self.grid,
            window=self.window,
            guards=self.guards,
            passes=self.passes,
            shots=shots,
            refreshes=sum(s.refreshes for s in shots),
            seconds=sum(s.exposure_s for s in shots),
            light_share=next(s.light_share for s in shots if s.name == main),
            raw_files=len(shots),
        )


def make_plan(request: CaptureRequest, config: Config, grid: tuple[int, int]) -> Plan:
    """Resolve a request against the configuration.

    Raises ConfigError when the request contradicts itself, the rig, or the limits.
    """
    schedule = config.schedule
    wanted = goal(request.goal, request.p)
    black: BlackLevel = request.black_level or schedule.black_level
    recipe = make_recipe(wanted, black_level=black, white=request.white)
    cell_px = min(config.projector.size_px[1] / grid[0], config.projector.size_px[0] / grid[1])
    if cell_px < 1.0:
        raise ConfigError(
            f"a grid of {grid[0]} x {grid[1]} cells is finer than the projector's pixels",
            device="projector",
            hint="use a coarser scene grid",
        )
    window = choose_window(
        request.window or schedule.window, config.rig.misregistration_px / cell_px
    )
    guards = schedule.guards if request.guards is None else request.guards
    count = request.codes if request.codes is not None else schedule.codes
    p = request.p if request.p is not None else 0.5
    family = request.family or schedule.family
    if request.family is None and family == "hadamard" and p != 0.5:
        family = "balanced"  # Hadamard columns are lit half of the time
    codes = None
    if recipe.dual is not None:
        lattice = Lattice(grid, window)
        codes = make_codes(family, lattice.shape, count, dual=recipe.dual, p=p, seed=request.seed)
    refresh_hz = min(config.projector.refresh_hz, config.mask.refresh_hz)
    per_slot = GUARDED_REFRESHES if guards else 1
    fields = Lattice(grid, window).fields if codes is not None else 1
    one_pass_s = count * fields * per_slot / refresh_hz
    passes = 1
    if request.exposure_s is not None:
        passes = int(request.exposure_s / one_pass_s + 1e-9)
        if passes < 1:
            raise ConfigError(
                f"an exposure of {request.exposure_s:g} s is shorter than one pass over "
                f"{count} codes ({one_pass_s:.3g} s)",
                hint="ask for fewer codes or a longer exposure",
            )
    # A white shot that gathers about as much light as the indirect one keeps the camera at one
    # setting; as the goal itself it takes as many slots as codes were asked for.
    share = p * (1.0 - p) if recipe.goal != WHITE else 1.0
    plan = Plan(
        recipe=recipe,
        codes=codes,
        family=family if codes is not None else "none",
        count=count,
        p=p,
        grid=grid,
        window=window,
        guards=guards,
        passes=passes,
        white_slots=max(1, round(count * passes * share)),
        refresh_hz=refresh_hz,
        settle_s=config.rig.settle_s,
    )
    longest = max(plan.exposure_s(s) for s in recipe.shots)
    if longest > config.limits.max_exposure_s:
        raise ConfigError(
            f"the plan needs an exposure of {longest:.1f} s; the limit is "
            f"{config.limits.max_exposure_s:g} s",
            hint="ask for fewer codes, or raise limits.max_exposure_s",
        )
    return plan
