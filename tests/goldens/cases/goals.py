"""Every goal, with the program's own codes and with 64 Hadamard and 64 Bernoulli codes.

Parts are always named, 1 and 4: what the program chooses where nothing is said may change. Where a
goal takes none of these, how it is refused is the golden.
"""

from __future__ import annotations

from dataclasses import replace

from tests.goldens.case import Case
from tests.goldens.cases.captures import Capture

OFF_AXIS = '[rig]\narrangement = "off-axis"\n'
GOALS = (
    Capture("white", "white"),
    Capture("indirect", "indirect", page=True),
    Capture("direct", "direct"),
    Capture("fraction", "fraction --p 0.25"),
    Capture("illuminated", "illuminated", arrays=("illumination",)),
    Capture("diagonal", "diagonal"),
    Capture("off-diagonal", "off-diagonal --shift 0 1"),
    Capture("warped", "warped", arrays=("warp",)),
    Capture("two-samples", "two-samples --mix 0.7 -0.3", arrays=("warp", "warp-b")),
    Capture("relit", "relit", arrays=("matrix",)),
    Capture("long-range", "long-range --radius 2"),
    Capture("short-range", "short-range --radius 2"),
    Capture("blocked", "blocked", arrays=("region-a", "region-b")),
    Capture("descattered", "descattered --shift 0 -1"),
    Capture("filtered", "filtered", arrays=("kernel",)),
    Capture("split", "split --period 4"),
    Capture("keyed", "keyed --disparity -1 0", OFF_AXIS, scene="off-axis-box"),
    Capture("epipolar", "epipolar", OFF_AXIS, scene="off-axis-wedge"),
    Capture("stereo", "stereo --disparity -2 0", OFF_AXIS, scene="off-axis-shelf"),
    Capture("transport", "transport --rows 3 5"),
)
CODES = {
    "plain": "",
    "hadamard": " --codes 64 --family hadamard",
    "bernoulli": " --codes 64 --family bernoulli",
}
VARIANTS = (
    Capture("indirect-shift", "indirect --shift 1 0 --codes 32"),
    Capture("indirect-lit", "indirect --codes 32", arrays=("illumination",)),
    Capture("direct-warp", "direct --codes 32", arrays=("warp:shifted",)),
    Capture("fraction-lit", "fraction --p 25% --codes 32", arrays=("illumination",)),
    Capture("fraction-equal", "fraction --p 0.25 --codes 32 --equal-brightness"),
    Capture("off-diagonal-p", "off-diagonal --shift 1 -2 --p 0.25 --codes 64"),
    Capture("diagonal-lit", "diagonal --codes 32", arrays=("illumination",)),
    Capture("split-warp", "split --period 8 --codes 32", arrays=("warp:shifted",)),
    Capture("long-range-lit", "long-range --radius 1 --codes 32", arrays=("illumination",)),
    Capture("long-range-grey", "long-range --radius 3 --codes 32 --grey-masks"),
    Capture("long-range-black", "long-range --radius 3 --codes 32 --no-grey-masks"),
    Capture("short-range-grey", "short-range --radius 1 --codes 32 --grey-masks"),
    Capture("relit-even", "relit --codes 32", arrays=("matrix:even",)),
    Capture("relit-few", "relit --codes 32", arrays=("matrix:few",)),
    Capture("relit-low-rank", "relit --codes 32", arrays=("matrix:low-rank",)),
    Capture("epipolar-out", "epipolar --keep out --codes 32", OFF_AXIS, scene="off-axis-wedge"),
    Capture("keyed-plane", "keyed --plane 1 0 0.05 0 1 0 0 0 1 --disparity 0", OFF_AXIS,
            scene="off-axis-box"),
    Capture("stereo-disparities", "stereo --disparity -1 1 --codes 32", OFF_AXIS,
            scene="off-axis-shelf", arrays=("disparities",)),
    Capture("keyed-warp", "keyed --codes 32", OFF_AXIS, scene="off-axis-box",
            arrays=("warp:shifted",)),
    Capture("transport-all", "transport", grid=(4, 6)),
    Capture("transport-masked", "transport --rows 3 5 --masked"),
    Capture("isolation", "indirect --family isolation", grid=(3, 4)),
    Capture("confocal", "indirect --family confocal", grid=(3, 4)),
)  # fmt: skip


def cases() -> list[Case]:
    """Goals times codes times parts, and what else goals take."""
    found = []
    for goal in GOALS:
        for codes, options in CODES.items():
            for parts in (1, 4):
                found.append(
                    replace(
                        goal,
                        name=f"goals/{goal.name}/{codes}-{parts}",
                        options=f"{goal.options}{options} --parts {parts}",
                        page=goal.page and codes == "plain",
                    )
                )
    for one in VARIANTS:
        options = f"{one.options} --parts 1"
        found.append(replace(one, name=f"goals/more/{one.name}", options=options))
    large = Capture(
        "goals/large", "indirect --codes 128 --parts 4", grid=(48, 64), page=True, weight=12.0
    )
    return [one.case() for one in (*found, large)]
