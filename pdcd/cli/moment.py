"""A moment as people type it: a date, or how long ago."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

from pdcd.cli.typed import WHEN
from pdcd.errors import ConfigError

UNITS = {"s": "seconds", "m": "minutes", "h": "hours", "d": "days", "w": "weeks"}


def moment(text: str, option: str, now: datetime | None = None) -> datetime:
    """The moment in UTC; a date without a zone is one of this machine's.

    Raises ConfigError, which names the `option`.
    """
    now = datetime.now(UTC) if now is None else now
    ago = re.fullmatch(r"(\d{1,6})([smhdw])", text)
    try:
        if ago is not None:
            return now - timedelta(**{UNITS[ago[2]]: int(ago[1])})
        # A moment without a zone is taken for one of this machine's.
        return datetime.fromisoformat(text).astimezone(UTC)
    except (ValueError, OverflowError) as err:
        raise ConfigError(f"{option} {text!r} is no moment", hint=f"it takes {WHEN}") from err
