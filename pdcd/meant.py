"""Guesses what was meant by a number or word that must be refused, for the error's hint."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_PER_UNIT = {"ms": 0.001, "s": 1.0, "sec": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)"
_MOST_READ = 64
"""Longest text that may have been meant as a number; matching may take quadratic time."""
_PAIR = re.compile(r"\s*(\d+)\s*[x,;* -]\s*(\d+)\s*")


def suggest_word(text: str, words: Iterable[str]) -> str:
    """The word that is nearest to a text; "" where none is near."""
    near = difflib.get_close_matches(text, list(words), n=1)
    return near[0] if near else ""


def suggest_pair(text: str) -> tuple[str, str] | None:
    """The two whole numbers of a text such as "1920x1080"."""
    match = _PAIR.fullmatch(text) if len(text) <= _MOST_READ else None
    return None if match is None else (match[1], match[2])


def suggest_number(text: str, *, whole: bool = False) -> str:
    """The number that was probably meant, in plain digits; "" if it cannot be guessed.

    Units of time and minutes:seconds become seconds, fractions and percentages numbers, and commas
    points. `whole` : whether only whole numbers are allowed.
    """
    shown, found = text.strip().lower(), None
    if len(shown) > _MOST_READ:
        return ""
    if match := re.fullmatch(rf"({_NUMBER})\s*({'|'.join(_PER_UNIT)})", shown):
        found = float(match[1]) * _PER_UNIT[match[2]]
    elif match := re.fullmatch(r"(\d+):([0-5]\d)", shown):
        found = 60.0 * int(match[1]) + int(match[2])
    elif (match := re.fullmatch(rf"({_NUMBER})/({_NUMBER})", shown)) and float(match[2]):
        found = float(match[1]) / float(match[2])
    elif match := re.fullmatch(rf"({_NUMBER})\s*%+", shown):
        found = float(match[1]) / 100.0
    elif whole and re.fullmatch(r"\d{1,3}(,\d{3})+", shown):
        found = float(shown.replace(",", ""))
    elif re.fullmatch(r"[+-]?\d*,\d+", shown):
        found = float(shown.replace(",", "."))
    elif re.fullmatch(rf"{_NUMBER}(e[+-]?\d)?", shown):
        found = float(shown)
    if found is None or (whole and not found.is_integer()):
        return ""
    return f"{int(found)}" if whole else f"{found:.6g}"
