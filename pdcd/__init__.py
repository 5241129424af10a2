"""pdcd: a projector, an LCD mask and a camera that photograph chosen light paths.

::

    import pdcd

    with pdcd.local() as bench:
        run = bench.capture("indirect", codes=64)
    print(run.quality.verdict, run.image.mean())

Every name in `__all__` is explained in docs/python.md. `import pdcd` loads only these lines; each
name loads what it needs when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from pdcd.version import __version__

if TYPE_CHECKING:
    from pdcd import errors
    from pdcd.api.bench import Bench
    from pdcd.api.connected import connect
    from pdcd.api.local import local
    from pdcd.api.run import Run
    from pdcd.api.run import open_run as open
    from pdcd.api.sweep import sweep
    from pdcd.api.table import Table

__all__ = [
    "Bench",
    "Run",
    "Table",
    "__version__",
    "connect",
    "errors",
    "local",
    "open",
    "sweep",
]

_HOMES = {
    "Bench": ("pdcd.api.bench", "Bench"),
    "Run": ("pdcd.api.run", "Run"),
    "Table": ("pdcd.api.table", "Table"),
    "connect": ("pdcd.api.connected", "connect"),
    "errors": ("pdcd.errors", None),
    "local": ("pdcd.api.local", "local"),
    "open": ("pdcd.api.run", "open_run"),
    "sweep": ("pdcd.api.sweep", "sweep"),
}
"""Where each name is defined: a module, and its name there; None: the module itself."""


if not TYPE_CHECKING:  # so that a type checker knows which names do not exist

    def __getattr__(name: str) -> object:
        try:
            module, called = _HOMES[name]
        except KeyError:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
        home = importlib.import_module(module)
        found = home if called is None else getattr(home, called)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
