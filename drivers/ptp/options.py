"""[camera.options] and [trigger.options] of the `ptp` drivers."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from pdcd.driver import Config, merge_camera_options, read_options

ReleaseName = Literal["auto", "remote", "bulb", "external"]


class PtpOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which camera, and how it is used; all may be left out where there is one camera."""

    usb: Annotated[str, Meta(min_length=1)] = "libusb"
    """The machine's own libusb, or the name of a driver of the role `usb`: "virtual" is a camera in
    this process that photographs the mock bench."""
    id: Annotated[str, Meta(pattern="^[0-9a-fA-F]{4}:[0-9a-fA-F]{4}$")] | None = None
    """USB vendor and product, as "04a9:3145"; None: any of Canon's."""
    serial: str | None = None
    """Serial number that the camera reports; needed if two cameras are alike."""
    release: ReleaseName = "auto"
    """How to open the shutter: as the camera offers it, or a way that is forced."""
    destination: Literal["ram", "card"] = "ram"
    """Where the camera puts its files before they are fetched; on the "card" they also stay."""
    read_twice: bool = True
    """Read each photo a second time and compare; takes as long as the first time."""

    @property
    def in_process(self) -> bool:
        """Whether the camera is a virtual one, which ends with this process."""
        return self.usb != "libusb"

    @property
    def usb_id(self) -> tuple[int, int] | None:
        """Vendor and product as numbers."""
        if self.id is None:
            return None
        vendor, _, product = self.id.partition(":")
        return int(vendor, 16), int(product, 16)


def read_ptp_options(config: Config) -> PtpOptions:
    """The options of this rig's one camera.

    [camera.options] and [trigger.options] are about the same camera if both drivers are `ptp`: it
    is enough to give them once. Raises ConfigError if they are wrong or disagree.
    """
    # A file in the camera's memory is lost unless it is fetched from there.
    start = {} if config.camera.driver == "ptp" else {"destination": "card"}
    merged, table = merge_camera_options(config, ("ptp",), start)
    return read_options(
        merged,
        PtpOptions,
        table=table,
        device="camera",
        hint="docs/cameras.md lists the options of the driver ptp",
    )
