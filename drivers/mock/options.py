"""The mock drivers take no options: what they do is said by the tables themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdcd.driver import ConfigError


def refuse_options(options: Mapping[str, Any], table: str, device: str) -> None:
    """Raise ConfigError when there are any: they are another driver's, and would be ignored."""
    if options:
        raise ConfigError(
            f"[{table}] {', '.join(options)}: the driver mock has no options",
            device=device,
            hint="name the driver that they belong to, or remove them",
        )
