"""The devices that a contract is tested on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import pytest

from pdcd.bench.config import from_config_tables, load_config
from pdcd.bench.devices import DriverContext
from pdcd.capture.rig import Rig
from pdcd.testing.promises import Promise

_Config = Mapping[str, Any] | Path | str

CREATE = Promise(
    "`create` makes the driver and opens no device; `maturity` says how far it is",
    "let `connect` open the device, and set maturity to experimental, beta or stable",
)
_MATURITIES = ("broken", "experimental", "beta", "stable")


def make_rig(config: _Config) -> Rig:
    """Display, shutter and readout of a configuration, on one clock; nothing is opened.

    config : the tables of a configuration file, or the path of one. What is left out is the mock
        bench. Raises ConfigError and DriverUnavailable as `pdcd config check` does.
    """
    if isinstance(config, Mapping):
        return Rig(from_config_tables(dict(config), "the configuration of the test"))
    return Rig(load_config(config))


class RigContract:
    """What contracts of all roles share: a rig whose devices of that role are connected."""

    config: ClassVar[_Config] = {}
    """Tables of a configuration file, or the path of one."""
    roles: ClassVar[tuple[str, ...]]
    """Devices that a test needs open, the one it is about first."""

    @pytest.fixture
    def rig(self) -> Iterator[Rig]:
        """The rig that is tested; override it where `config` does not say all."""
        rig = make_rig(self.config)
        try:
            for role in reversed(self.roles):
                getattr(rig, role).connect()
            yield rig
        finally:
            rig.disconnect()

    def test_create_touches_no_device(self, rig: Rig) -> None:
        """A second driver may be made while one is open, and one that was never connected ended."""
        with CREATE.keep():
            self.make_fresh(rig).disconnect()
        maturity = rig.maturity[self.roles[0]]
        CREATE.require(maturity in _MATURITIES, f"maturity {maturity!r}")

    def make_fresh(self, rig: Rig) -> Any:
        """A driver of the same configuration that was never connected."""
        kind: Any = type(getattr(rig, self.roles[0]))
        return kind.create(DriverContext(rig.config, rig.clock))
