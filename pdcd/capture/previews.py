"""Previews are looked at once: of their folders the last few are kept."""

from __future__ import annotations

import logging
import re
import shutil
from pathlib import Path

logger = logging.getLogger(__name__)

PREVIEWS_KEPT = 8
"""Previews that stay on the disk."""

_OWN = re.compile(r"\d{8}T\d{6}Z-[0-9a-f]{4}(\.partial)?")
"""How previews are called: by their job, which begins with the time."""


def remove_old_previews(folder: Path) -> None:
    """Remove all previews below `folder` but the last `PREVIEWS_KEPT`; whatever else lies there
    stays.

    What cannot be removed is logged and left: a full disk or a lost right is no reason to fail.
    """
    try:
        found = [p for p in folder.iterdir() if _OWN.fullmatch(p.name) and not p.is_symlink()]
    except OSError as err:
        logger.warning("cannot look for old previews folder=%s error=%s", folder, err)
        return
    for old in sorted(found, key=lambda p: p.name)[:-PREVIEWS_KEPT]:
        try:
            shutil.rmtree(old)  # does not follow links
        except OSError as err:
            logger.warning("cannot remove an old preview folder=%s error=%s", old, err)
