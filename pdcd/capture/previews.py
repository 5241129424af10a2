"""Previews are looked at once: only the last few of their folders are kept."""

from __future__ import annotations

import logging
import re
import shutil
from pathlib import Path

from pdcd.errors import restore_error
from pdcd.files.reading import MAX_PICTURE_BYTES, hash_file, refuse_unsound
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.views import PreviewView
from pdcd.runs.folder import read_manifest

logger = logging.getLogger(__name__)

PREVIEWS_KEPT = 8
"""Previews that stay on the disk."""

_OWN = re.compile(r"\d{8}T\d{6}Z-[0-9a-f]{4}(\.partial)?")
"""Names of previews: those of their jobs, which begin with the time."""


def remove_old_previews(folder: Path) -> None:
    """Remove all previews below `folder` but the last `PREVIEWS_KEPT`; anything else there stays.

    What cannot be removed is logged and left: a full disk or a lost permission is no reason to
    fail.
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


def read_preview(result: CaptureResult) -> PreviewView:
    """The view of a preview that was taken. Raises the error with which its photo ended."""
    if result.folder is None or result.state != "done":
        raise restore_error(result.error)
    folder = Path(result.folder)
    path = folder / "preview" / "white.png"
    record = read_manifest(folder).run
    height, width = (0, 0) if record.cells is None else record.cells.frame
    with refuse_unsound(path):
        digest = hash_file(path, MAX_PICTURE_BYTES)
    shape = height, width, len(record.responsivity_e)
    return PreviewView(path=str(path), sha256=digest, shape=shape)
