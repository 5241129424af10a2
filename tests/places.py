"""Where things of the source tree lie, for tests in any room."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
DATA = Path(__file__).parent / "data"
