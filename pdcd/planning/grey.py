"""What a plan says of the grey levels that its codes need."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from pdcd.bench.tables import Config, PanelConfig
from pdcd.planning.plan import Pair

PANELS = ("projector", "mask")


def grey_panels(pairs: Iterable[Pair]) -> tuple[str, ...]:
    """Which panels are sent anything but black and white."""
    grey = [[part.dtype != np.uint8 for part in pair] for pair in pairs]
    return tuple(name for n, name in enumerate(PANELS) if any(pair[n] for pair in grey))


def grey_reasons(pairs: Iterable[Pair], config: Config) -> Iterator[str]:
    """What grey levels are sent by, a line for each panel that shows any."""
    for name in grey_panels(pairs):
        panel: PanelConfig = getattr(config, name)
        if panel.lut is not None:
            yield f"grey levels of the {name}: 8 bits, by a table of {len(panel.lut)} lights"
        elif panel.gamma is not None:
            yield f"grey levels of the {name}: 8 bits, gamma {panel.gamma:g}"
        elif unsaid(panel, config):
            yield unknown(name)


def grey_warnings(pairs: Iterable[Pair], config: Config) -> Iterator[str]:
    """What the user of a finished run must know of its grey levels."""
    for name in grey_panels(pairs):
        if unsaid(getattr(config, name), config):
            yield unknown(name)


def unsaid(panel: PanelConfig, config: Config) -> bool:
    """Whether nobody said what light a panel's grey levels give, and it may be anything."""
    return panel.gamma is None and panel.lut is None and not as_described(config)


def as_described(config: Config) -> bool:
    """Whether the panels are those of a mock bench that is as its configuration says."""
    return config.display.driver == "mock" and config.bench.truth is None


def unknown(name: str) -> str:
    """That nobody said what light a panel's grey levels give."""
    return (
        f"the {name} shows grey levels, and what light they give is not known: they are taken as "
        f"light, and a panel with gamma shows other weights than were asked for; run pdcd "
        f"calibrate response, or set {name}.gamma"
    )
