"""Requests that mean harm, as lines of the socket and descriptors beside them."""

from __future__ import annotations

import base64
import json
import os
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pdcd import words
from pdcd.protocol.fields import ARRAY_FIELDS, list_needed_fields
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import KEEPS
from tests.hostile import files
from tests.hostile.files import Random

SCALARS: tuple[Any, ...] = (
    0, -1, 1, 2, 3, 4, 7, 8, 12, 16, 64, 1024, 4096, 65536, 2**31, 2**53 - 1, 2**53, 2**63, 2**64,
    10**30, 10**400, -(2**63), 0.0, -0.0, 0.5, 0.25, 0.999999, 1e-9, 1e-300, 5e-324, 1e300, -1e300,
    1.7976931348623157e308, float("nan"), float("inf"), True, False, None, "", "\0", "a\nb",
    "a" * 5000, "é", "\U0001d518", "\ud800", "\x1b[2J", "../../etc/shadow", "/dev/zero", "white",
    [], {}, [[]], [[], []], [0, 0], [1, -1], [2, 3], [1e300, 1e300], [0.0, 0.0],
    [2**40, 2**40], {"fd": 0}, {"npy": ""},
)  # fmt: skip
NAMES = (
    "good.npy", "secret", "fifo", "loop", "link", "sparse", "zero", "socket", "sub", "sub/x",
    "../secret", "/etc/shadow", "/dev/zero", "", ".", "..", "a\0b", "é.npy", "\ud800", "a" * 300,
    "/".join(["a"] * 2000), "a\nb", "good.npy/", "//good.npy", "sub/../good.npy", "good.npy\0.png",
)  # fmt: skip
CHOICES: dict[str, tuple[Any, ...]] = {
    "family": get_args(words.FamilyName),
    "method": get_args(words.MethodName),
    "window": get_args(words.WindowName),
    "guards": (*get_args(words.GuardsName), True, False),
    "black_level": get_args(words.BlackLevel),
    "normalise": get_args(words.NormaliseName),
    "codes": (2, 4, 8, 12, 16, 32, 64, 65536),
    "p": (0.5, 0.25, 0.125, 0.3, 1e-9, 0.999999999),
    "pilot": (8, 12, 16, 32, 64, 4096),
    "parts": (1, 2, 4, 8, 64),
    "repeat": (1, 2, 1024),
    "until_error": (0.5, 1e-9, 0.999),
    "error": (0.5, 0.1, 1e-9, 0.999),
    "confidence": (0.5, 0.95, 0.999999999),
    "seconds": (1e-9, 0.5, 5.0, 1e6, 1e300),
    "prior": ("scene:disco-ball", "scene:", "decay:3", "decay:1e-300", "decay:1e300", "decay:nan"),
    "exposure_s": (1e-9, 0.1, 1.0, 3600.0),
    "seed": (0, 1, 2**53 - 1),
    "shift": ([0, 1], [0, 0], [-1, 2], [2**31, 0]),
    "radius": (0, 1, 2, 3, 100, 30000, 2**40),
    "mix": ([0.5, 0.5], [1e300, -1e300], [0.0, 0.0], [5e-324, 1.0]),
    "period": (4, 8, 12, 2**40),
    "smooth": (True, False),
    "white": (True, False),
    "note": ("", "n" * 4096, "\0", "\x1b]0;x\a"),
    "out": (
        ".",
        "a/b",
        "..",
        "/etc",
        "\0",
        "x" * 300,
        "/".join(["d"] * 1000),
        "\ud800",
        "é",
        "a\nb",
    ),
}


@dataclass(frozen=True)
class Attack:
    """One line to a daemon, and the descriptors that go with it; `close` when it is over."""

    line: bytes
    fds: tuple[int, ...]
    uid: int

    def close(self) -> None:
        """Close the descriptors of the sender."""
        for descriptor in self.fds:
            os.close(descriptor)


def attacks(
    seed: int, count: int, folder: Path, grid: tuple[int, int] = (3, 4)
) -> Iterator[Attack]:
    """So many attacks on a daemon whose folder of arrays is `folder`, where `kinds` has been."""
    rng = random.Random(seed)
    for _ in range(count):
        yield _attack(rng, folder, grid)


def _attack(rng: Random, folder: Path, grid: tuple[int, int]) -> Attack:
    goal = rng.choice(list(KEEPS))
    params: dict[str, Any] = {"goal": goal}
    made: list[int] = []
    for name in list_needed_fields(goal):
        params[name] = _fitting(rng, name, grid)
    fields = [f for f in CaptureRequest.__struct_fields__ if f != "goal"]
    for name in rng.sample(fields, rng.randrange(0, 4)):
        params[name] = rng.choice(CHOICES[name]) if name in CHOICES else None
    for name in {*ARRAY_FIELDS, "prior"} & {*params}:
        if rng.random() < 0.7:
            params[name] = _array(rng, name, folder, grid, made)
    if rng.random() < 0.15:
        params[rng.choice([*fields, "goal", "detach", "queue", "surplus"])] = rng.choice(SCALARS)
    method = rng.choice(("capture.plan", "capture.plan", "capture.plan", "capture.start"))
    if method == "capture.plan":
        params.pop("detach", None)
    message = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params, "fds": len(made)}
    line = json.dumps(message).encode()
    if rng.random() < 0.01:
        line = line.replace(b'"params": {', b'"params": {"matrix": ' + b"[" * 50000, 1)
    return Attack(line, tuple(made), rng.choice((os.getuid(), 65534, 0)))


def _fitting(rng: Random, name: str, grid: tuple[int, int]) -> Any:
    """A value that the goal can use, mostly."""
    rows, columns = grid
    if name == "kernel":
        return [[float(rng.randrange(-2, 3)) for _ in range(3)] for _ in range(3)]
    if name == "matrix":
        return [[rng.random() for _ in range(rows * columns)] for _ in range(rows * columns)]
    if name in ARRAY_FIELDS:
        return [[float(rng.randrange(2)) for _ in range(columns)] for _ in range(rows)]
    return rng.choice(CHOICES[name])


def _array(rng: Random, name: str, folder: Path, grid: tuple[int, int], made: list[int]) -> Any:
    """An array given in any of the four ways; descriptors are added to `made`."""
    cells = grid[0] * grid[1]
    shape = (3, 3) if name == "kernel" else (cells, cells) if name == "matrix" else grid
    match rng.randrange(8):
        case 0:
            return [[rng.choice((0, 1, 1e300, 1e-320, 10**30, -1, 0.5)) for _ in range(shape[1])]
                    for _ in range(rng.choice((shape[0], 1, 0, 5)))]  # fmt: skip
        case 1:
            return rng.choice(NAMES)
        case 2:
            named = folder / rng.choice(("fifo", "folder", "secret", "sparse", "zero", "good.npy"))
            made.append(files.opened(rng, named))
        case 3 | 4:
            content = rng.choice(files.CONTENTS)(rng, shape)
            text = base64.b64encode(content).decode()
            if len(text) > 900_000 or rng.random() < 0.05:
                text = text[: rng.randrange(1000)] + rng.choice(("", "=", "é", "\n", "===="))
            return {"npy": text} | _label(rng)
        case 5:
            return {"fd": rng.choice((0, 1, 63, 64, -1, 2**40))} | _label(rng)
        case _:
            made.append(_in_memory(rng.choice(files.CONTENTS)(rng, shape)))
    return {"fd": len(made) - 1} | _label(rng)


def _label(rng: Random) -> dict[str, str]:
    return {"file": rng.choice(NAMES)} if rng.random() < 0.2 else {}


def _in_memory(content: bytes) -> int:
    descriptor = os.memfd_create("hostile", os.MFD_CLOEXEC)
    os.write(descriptor, content)
    return descriptor
