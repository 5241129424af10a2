"""`python -m pdcd.presenter FD`: the display process, on one end of a socket pair."""

import faulthandler
import os
import sys
from importlib.util import find_spec
from pathlib import Path

# The wheel brings libraries for X11 and Wayland and would guess from the session.
os.environ["PYGLFW_LIBRARY_VARIANT"] = "x11"
# Unless the library is named, it starts an interpreter for each that it finds, to ask its version.
_glfw = find_spec("glfw")
_library = Path(_glfw.origin).with_name("x11") / "libglfw.so" if _glfw and _glfw.origin else None
if _library is not None and _library.is_file():
    os.environ.setdefault("PYGLFW_LIBRARY", str(_library))
# Mesa's software renderer draws on the thread that asks. With threads of its own it frees a fence
# that one of them is still unlocking, which now and then damages memory (seen with Mesa 22.3).
os.environ.setdefault("LP_NUM_THREADS", "0")

if __name__ == "__main__":
    from pdcd.presenter.process import run_display_process

    faulthandler.enable()  # a crash inside a library says where it was
    raise SystemExit(run_display_process(int(sys.argv[1])))
