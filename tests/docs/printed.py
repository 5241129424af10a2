"""Is what a page shows what a command prints?

Words have to be the same; where lines break does not matter. ``...`` stands for anything, also at
the beginning of a path. Numbers with a point may differ in their last digit by one, or by a
twentieth: the noise of a photo is drawn alike everywhere, but libraries round in other ways. Names
of jobs and wall times are what they are.
"""

from __future__ import annotations

import re

_NEAR, _LAST_DIGITS = 0.05, 1.5
_JOB = re.compile(r"\d{8}T\d{6}Z-[0-9a-f]{4}")
_WALL = re.compile(r"^(wall time\s+)\S.*$", re.MULTILINE)
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def find_difference(told: str, printed: str) -> str:
    """What the page shows and the command did not print, in this order; "" if it printed all."""
    have = _JOB.sub("JOB", printed).split()
    at = 0
    for words in _list_runs(_WALL.sub(r"\1...", _JOB.sub("JOB", told)).split()):
        starts = range(at, len(have) - len(words) + 1)
        found = next((k for k in starts if _is_alike(words, have[k : k + len(words)])), None)
        if found is None:
            return f"not printed: {_name_first(words, have[at:])}"
        at = found + len(words)
    return ""


def is_near(told: str, printed: str) -> bool:
    """Two numbers as they are written."""
    if "." not in told and "." not in printed:
        return told == printed
    digits = len(told.partition(".")[2])
    bound = max(_NEAR * abs(float(told)), _LAST_DIGITS * 10.0**-digits)
    return abs(float(told) - float(printed)) <= bound


def find_figure(name: str, printed: str) -> str | None:
    """The number that was printed last behind a name; None where there is none."""
    found = re.findall(rf"{re.escape(name)}\s+(\d+(?:\.\d+)?)", printed)
    return found[-1] if found else None


def _list_runs(words: list[str]) -> list[list[str]]:
    """What stands between one "..." and the next."""
    runs: list[list[str]] = [[]]
    for word in words:
        if word == "...":
            runs.append([])
        else:
            runs[-1].append(word)
    return [run for run in runs if run]


def _is_alike(told: list[str], printed: list[str]) -> bool:
    return all(_is_word(one, other) for one, other in zip(told, printed, strict=True))


def _is_word(told: str, printed: str) -> bool:
    if told.startswith("..."):
        return printed.endswith(told[3:])
    if told == printed:
        return True
    if _NUMBER.split(told) != _NUMBER.split(printed):
        return False
    pairs = zip(_NUMBER.findall(told), _NUMBER.findall(printed), strict=True)
    return all(is_near(one, other) for one, other in pairs)


def _name_first(words: list[str], have: list[str]) -> str:
    """The word at which the best of all places stops to be alike, and what stands there."""
    best, instead = 0, ""
    for k in range(len(have)):
        length = 0
        while length < min(len(words), len(have) - k) and _is_word(words[length], have[k + length]):
            length += 1
        if length >= best:
            best = length
            instead = " ".join(have[k + max(0, length - 3) : k + length + 3])
    near = " ".join(words[max(0, best - 3) : best + 3])
    return f"{near!r}, but {instead!r}"
