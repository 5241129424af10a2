"""A case, the place it works in, and what it keeps."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.goldens.masks import Masks
from tests.goldens.program import Said, call_pdcd

SUMS = "sums.json"
"""Digests of files that are too large, or too dull, to keep."""


@dataclass(frozen=True)
class Case:
    """One case. weight : about how many seconds it takes; the dearest begin first."""

    name: str
    take: Callable[[Bench], None]
    weight: float = 1.0


class UnavailableError(Exception):
    """This machine lacks what a case needs, and why."""


class Bench:
    """Where a case works: a scratch folder, which is the working folder, and what it keeps."""

    def __init__(self, scratch: Path, out: Path, masks: Masks) -> None:
        self.scratch, self.out, self.masks = scratch, out, masks
        self._sums: dict[str, str] = {}

    def write(self, name: str, text: str) -> str:
        """Write a text file into the scratch folder; returns its name."""
        (self.scratch / name).write_text(text)
        return name

    def write_array(self, name: str, array: np.ndarray) -> str:
        """Write an array as a .npy file into the scratch folder; returns its name."""
        np.save(self.scratch / name, array)
        return name

    def pdcd(self, *words: str) -> Said:
        """Call the command line in this process, in the scratch folder."""
        return call_pdcd(words)

    def keep_json(self, name: str, value: Any) -> None:
        """Keep plain values as NAME.json, masked."""
        masked = self.masks.of_value(value)
        text = json.dumps(masked, indent=1, ensure_ascii=False)
        self._path(f"{name}.json").write_text(text + "\n")

    def keep_said(self, name: str, said: Said) -> None:
        """Keep what a command ended with: exit code and JSON."""
        self.keep_json(name, {"exit": said.code, "out": said.lines})

    def keep_text(self, name: str, text: str) -> None:
        """Keep a text, masked, under a name with its ending."""
        self._path(name).write_text(self.masks.of_text(text))

    def keep_bytes(self, name: str, data: bytes) -> None:
        """Keep a file as it is, under a name with its ending."""
        self._path(name).write_bytes(data)

    def keep_arrays(self, name: str, arrays: Mapping[str, Any]) -> None:
        """Keep arrays as NAME.npz."""
        file = io.BytesIO()
        found: dict[str, Any] = {key: np.asarray(array) for key, array in arrays.items()}
        np.savez_compressed(file, **found)
        self.keep_bytes(f"{name}.npz", file.getvalue())

    def keep_sum(self, name: str, data: bytes) -> None:
        """Keep the digest of a file only."""
        self._sums[name] = hashlib.sha256(data).hexdigest()

    def end(self) -> None:
        """Write what was collected."""
        if self._sums:
            self.keep_json(SUMS.removesuffix(".json"), dict(sorted(self._sums.items())))

    def _path(self, name: str) -> Path:
        path = self.out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path
