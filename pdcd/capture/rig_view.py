"""A rig as clients and run folders are told of it."""

from __future__ import annotations

from pdcd.capture.rig import Rig
from pdcd.protocol.views import CameraView, DriverView, RigView


def describe_rig(rig: Rig) -> RigView:
    """The rig as found: drivers, panels, camera, scene. Called by the engine."""
    config, info = rig.config, rig.camera_info
    drivers = {
        "display": config.display.driver,
        "shutter": config.trigger.driver,
        "readout": config.camera.driver,
    }
    camera = None
    if info is not None:
        camera = CameraView(
            model=info.model,
            serial=info.serial,
            profile=info.profile,
            responsivity_e=tuple(info.responsivity_e.tolist()),
            isos=info.isos,
            f_numbers=info.f_numbers,
        )
    return RigView(
        name=config.rig.name,
        mock=rig.mock,
        grid=rig.grid,
        drivers={
            role: DriverView(name=name, maturity=rig.maturity[role])
            for role, name in drivers.items()
        },
        display=rig.display_info,
        shutter=rig.shutter_info,
        camera=camera,
        scene=None if rig.scene is None else rig.scene.name,
    )
