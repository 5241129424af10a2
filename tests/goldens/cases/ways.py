"""How a photo is taken: families, windows, schedules, methods, parts, pilots, wanted errors."""

from __future__ import annotations

from dataclasses import replace

from tests.goldens.case import Bench, Case
from tests.goldens.cases.benches import write_matrix
from tests.goldens.cases.captures import Capture

SLOW = "[mask]\nrise_s = 0.002\nfall_s = 0.004\ncontrast = 300.0\nskew_s = 0.001\n"
OFFSET = "[mask]\nsize_px = [1024, 768]\noffset_px = [3.0, -2.0]\n[rig]\nmisregistration_px = 4.0\n"
LEAKY = "[mask]\ncontrast = 200.0\n[projector]\ncontrast = 500.0\n"
PLANES = "[display]\nplanes_per_refresh = 24\n"
PAIR = "[camera]\nbuckets = 2\n"

FAMILIES = tuple(
    Capture(f"family/{name}", f"fraction --p 0.25 --codes 78 --family {name} --parts {parts}")
    if name == "singer"
    else Capture(f"family/{name}-{parts}", f"indirect --codes 48 --family {name} --parts {parts}")
    for name in ("rademacher", "balanced", "hadamard", "bernoulli", "singer")
    for parts in (1, 4)
    if not (name == "singer" and parts == 4)
)
WINDOWS = tuple(
    Capture(
        f"window/{name.replace('/', '-')}-{goal}",
        f"{goal} --codes 32 --parts {parts} --window {name}",
        OFFSET,
    )
    for name in ("auto", "whole", "quarter", "side-5/8", "side-3/4", "side-7/8")
    for goal, parts in (("indirect", 1), ("diagonal", 4))
)
SCHEDULES = tuple(
    Capture(f"schedule/{name}", f"indirect --codes 32 --parts {parts} --schedule {name}", SLOW)
    for name, parts in zip(
        ("none", "both", "lag", "lead", "tail", "full", "auto"), (1, 4, 1, 4, 1, 4, 1), strict=True
    )
)
GUARDS = (
    Capture("schedule/guards", "indirect --guards --error 8%", SLOW),
    Capture("schedule/no-guards", "indirect --codes 32 --parts 4 --no-guards", SLOW),
    Capture("schedule/fast-mask", "fraction --p 0.25 --codes 32 --parts 1 --schedule auto"),
)
METHODS = (
    Capture("method/pairs", "indirect --method pairs --codes 32 --parts 1"),
    Capture("method/pairs-4", "indirect --method pairs --codes 32 --parts 4", SLOW),
    Capture("method/pairs-buckets", "indirect --method pairs --codes 32 --parts 1", PAIR),
    Capture("method/buckets", "indirect --codes 32 --parts 4", PAIR),
    Capture("method/multi-image", "indirect --method multi-image --codes 16"),
    Capture("method/multi-image-bernoulli",
            "indirect --method multi-image --codes 16 --family bernoulli"),
    Capture("method/multi-image-warped", "warped --method multi-image --codes 32",
            arrays=("warp",)),
    Capture("method/nayar", "direct --method nayar"),
    Capture("method/nayar-indirect", "indirect --method nayar", LEAKY),
    Capture("method/nayar-planes", "direct --method nayar --schedule none", PLANES),
)  # fmt: skip
LEVELS = (
    *(
        Capture(f"black/{name}", f"indirect --codes 32 --parts 1 --black-level {name}", LEAKY)
        for name in ("auto", "none", "mask", "ambient", "both")
    ),
    Capture("black/ambient-light", "indirect --codes 32 --parts 4", LEAKY, ambient=0.05),
    Capture("black/scalar", "indirect --codes 32 --parts 1 --normalise scalar"),
    Capture("black/row", "fraction --p 0.25 --codes 32 --parts 4 --normalise row"),
)  # fmt: skip
PARTS = (
    Capture("parts/auto", "indirect --codes 128 --parts auto"),
    Capture("parts/16", "indirect --codes 64 --parts 16"),
    Capture("parts/until-error", "indirect --codes 128 --parts 16 --until-error 10%",
            scene="disco-ball"),
    Capture("parts/until-never", "indirect --codes 32 --parts 8 --until-error 0.01%"),
    Capture("parts/repeat", "indirect --codes 32 --parts 1 --repeat 2"),
    Capture("parts/none-asked", "indirect --codes 32"),
    Capture("pilot/8", "indirect --pilot 8 --codes 64 --parts 1", scene="mirror-and-vase"),
    Capture("pilot/12", "indirect --pilot 12 --codes 76 --parts 4", scene="mirror-and-vase"),
    Capture("pilot/16", "long-range --radius 2 --pilot 16 --codes 64 --parts 1",
            scene="mirror-and-vase"),
    Capture("pilot/32", "indirect --pilot 32 --codes 96 --parts 1", scene="disco-ball"),
    Capture("pilot/32-parts", "indirect --pilot 32 --codes 96 --parts 4", scene="disco-ball"),
    Capture("pilot/stops", "indirect --pilot 32 --codes 96 --parts 1"),
    Capture("pilot/auto", "indirect --pilot auto --codes 96 --parts 1", scene="mirror-and-vase"),
    Capture("pilot/all", "indirect --pilot 32 --codes 48", scene="disco-ball"),
    Capture("pilot/direct", "direct --pilot 8 --codes 64 --parts 1", scene="mirror-and-vase"),
)  # fmt: skip
ERRORS = (
    Capture("error/1", "indirect --error 1%"),
    Capture("error/1-parts", "indirect --error 1% --parts 4 --confidence 80%"),
    Capture("error/prior-scene", "indirect --error 2% --prior scene:wax-disk --parts 1"),
    Capture("error/prior-decay", "indirect --error 2% --prior decay:3 --parts 1"),
    Capture("error/fraction", "fraction --p 0.25 --error 3%"),
    Capture("error/long-range", "long-range --radius 2 --error 3% --prior decay:4"),
    Capture("error/seconds", "indirect --seconds 8"),
    Capture("error/seconds-parts", "direct --seconds 4 --parts 4"),
    Capture("error/seconds-white", "white --seconds 2"),
    Capture("error/prior-codes", "indirect --codes 64 --prior scene:mirror-and-vase --parts 1",
            scene="mirror-and-vase"),
    Capture("error/prior-matrix", "indirect --codes 32 --prior prior.npz --parts 1", weight=2.0),
)  # fmt: skip
OTHERS = (
    Capture("other/seed", "indirect --codes 32 --seed 5 --parts 1"),
    Capture("other/exposure", "indirect --codes 32 --exposure 4 --parts 1"),
    Capture("other/no-white", "indirect --codes 32 --no-white --parts 1"),
    Capture("other/white-patch", "indirect --codes 32 --white-patch 0.2 0.3 --parts 1"),
    Capture("other/no-smooth", "indirect --codes 32 --no-smooth --parts 4"),
    Capture("other/smooth-bernoulli", "indirect --codes 32 --family bernoulli --smooth --parts 4"),
    Capture("other/planes", "indirect --codes 64 --parts 4 --black-level ambient", PLANES),
    Capture("other/labels", "white --name first --tag a --tag b --note words"),
    Capture("other/refused", "indirect --codes 32 --radius 2 --parts 1"),
    Capture("other/too-many-parts", "indirect --codes 8 --parts 16"),
)


def cases() -> list[Case]:
    """All of them."""
    every = (*FAMILIES, *WINDOWS, *SCHEDULES, *GUARDS, *METHODS, *LEVELS, *PARTS, *ERRORS, *OTHERS)
    named = [replace(one, name=f"ways/{one.name}") for one in every]
    return [one.case(_write_prior) if "prior.npz" in one.options else one.case() for one in named]


def _write_prior(bench: Bench) -> None:
    """A transport matrix as a prior."""
    write_matrix(bench, "prior.npz")
