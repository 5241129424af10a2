"""What a bench's arrangement makes of a request."""

from __future__ import annotations

import msgspec

from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.recipes.goals import OFF_AXIS
from pdcd.request import CaptureRequest


def on_bench(request: CaptureRequest, config: Config) -> CaptureRequest:
    """The request with the bench's own plane, where it asks for depths and names none.

    Raises RequestError for depths on a coaxial bench, which has none.
    """
    if request.goal not in OFF_AXIS:
        return request
    rig = config.rig
    if rig.arrangement != "off-axis":
        raise RequestError(
            f"goal {request.goal} needs a camera off the projector's axis",
            hint='on such a bench set arrangement = "off-axis" in [rig]',
        )
    own = request.plane is None and request.disparities is None and request.warp is None
    if request.goal == "epipolar" or not own or rig.plane is None:
        return request
    return msgspec.structs.replace(request, plane=rig.plane)
