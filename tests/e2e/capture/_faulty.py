"""The work process with one fault in it: what it does instead of decoding a RAW file.

`_faulty.py FAULT FD`; FAULT is "segfault", "hang" or "exit".
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from typing import Any, NoReturn

from pdcd.child import end_with_parent


def main() -> int:
    fault, fd = sys.argv[1], int(sys.argv[2])
    end_with_parent()
    import rawpy

    def imread(*args: Any) -> NoReturn:
        if fault == "segfault":
            ctypes.string_at(0)
        elif fault == "hang":
            time.sleep(3600.0)
        os._exit(3)

    rawpy.imread = imread  # type: ignore[assignment]
    from pdcd.capture.worker import process

    return process.run_worker(fd)


if __name__ == "__main__":
    sys.exit(main())
