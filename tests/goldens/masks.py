"""What may differ from one run to the next, each with the reason, and how it is covered.

Nothing else is covered: what is not named here has to be equal.
"""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import Any

FIELDS: dict[str, str] = {
    "job": "names of jobs hold the time and chance",
    "started_utc": "time",
    "finished_utc": "time",
    "date": "time, in the EXIF of a photo",
    "wall_s": "how long the computer took",
    "computing_s": "how long the computer took",
    "pid": "process",
    "uid": "whoever runs this",
    "gid": "whoever runs this",
    "user": "whoever runs this",
    "owner": "whoever runs this",
    "versions": "of Python and of packages",
    "version": "of the program",
    "git_commit": "of the tree",
    "manifest_sha256": "the manifest holds times",
    "fingerprint": "of every line of the program",
}
"""Name of a field, wherever it stands -> why its value is covered."""

PLACES: dict[str, str] = {
    r"files\.(ledger\.jsonl|log\.jsonl|report\.html|capture\.json.*)\.size_bytes": (
        "these files hold numbers of processes, which may have more digits"
    ),
    r"out\.\d+\.size_bytes": "of a whole run, with these files",
    r"(steps\.|events\.\d+\.)?\d+\.seconds": (
        "how long the computer took over a step of a calibration"
    ),
    r"\d+\.sha256": "of a line of the ledger, which holds times",
}
"""Path of a field in its file, as a regular expression -> why its value is covered."""

TEXTS: dict[str, tuple[str, str]] = {
    "<job>": (r"\b\d{8}T\d{6}Z-[0-9a-f]{4}\b", "names of jobs hold the time and chance"),
    "<utc>": (r"\b\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|\+00:00| UTC)?", "time"),
    "<exif>": (r"\b\d{4}:\d\d:\d\d \d\d:\d\d:\d\d\b", "time, in the EXIF of a photo"),
    "<version>": (
        r"(?<=\bpdcd )\d+\.\d+\.\d+[\w.+]*|(?<=<td>pdcd</td><td>)[^<]*",
        "of the program, in pictures and on pages",
    ),
    "<wall>": (r"(?<=<dt>wall time</dt><dd>)[^<]*", "how long the computer took, on a report"),
    "<size>": (
        r"((?<=ledger\.jsonl</td><td>)|(?<=log\.jsonl</td><td>))\d+ bytes",
        "these files hold numbers of processes, on a report",
    ),
}
"""What stands instead -> what is looked for in every text, and why."""

TIMED = re.compile(r"(.*\.jsonl|.*/?(capture|calibration)\.json|.*report\.html)")
"""Files of a run that hold times: of them the content is compared, covered, and no digest."""
RAW_TIME = re.compile(rb"\d{4}:\d\d:\d\d \d\d:\d\d:\d\d")
"""When a photo was taken, in its file."""
DIGEST = re.compile(r"\b[0-9a-f]{64}\b")


class Masks:
    """Covers what differs. paths : folders of this run -> what stands instead."""

    def __init__(self, paths: dict[Path, str]) -> None:
        longest_first = sorted(paths.items(), key=lambda item: -len(str(item[0])))
        self._swaps = [(str(path), name) for path, name in longest_first]
        host = socket.gethostname()
        if len(host) > 4:  # a shorter one may stand for something else
            self._swaps.append((host, "<host>"))
        self._texts = [(re.compile(look), name) for name, (look, _) in TEXTS.items()]
        self._places = [re.compile(place) for place in PLACES]
        self._digests: dict[str, str] = {}
        self._fields = dict(FIELDS)

    def cover(self, fields: dict[str, str]) -> None:
        """Cover these fields, too: name -> reason."""
        self._fields |= fields

    def learn_digest(self, digest: str, name: str) -> None:
        """From now on this SHA-256, of a file that holds times, is told as `name`."""
        self._digests[digest] = name

    def of_text(self, text: str) -> str:
        """The text with paths, names of jobs, hosts, times and their digests covered."""
        for path, name in self._swaps:
            text = text.replace(path, name)
        for look, name in self._texts:
            text = look.sub(name, text)
        return DIGEST.sub(lambda found: self._digests.get(found[0], found[0]), text)

    def of_value(self, value: Any, at: tuple[str, ...] = ()) -> Any:
        """Plain values with what is named above covered."""
        if value is None:
            return None
        if at and at[-1] in self._fields:
            return f"<{at[-1]}>"
        if at and self._covered(".".join(at)):
            return "<covered>"
        if isinstance(value, dict):
            return {self.of_text(str(k)): self.of_value(v, (*at, str(k))) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return [self.of_value(one, (*at, str(k))) for k, one in enumerate(value)]
        return self.of_text(value) if isinstance(value, str) else value

    def of_raw(self, data: bytes) -> bytes:
        """The bytes of a photo without its time."""
        return RAW_TIME.sub(b"0000:00:00 00:00:00", data)

    def _covered(self, path: str) -> bool:
        return any(place.fullmatch(path) for place in self._places)
