"""`python -m pdcd.presenter FD`: the display process, on one end of a socket pair."""

import os
import sys

# The wheel brings libraries for X11 and Wayland and would guess from the session.
os.environ["PYGLFW_LIBRARY_VARIANT"] = "x11"

if __name__ == "__main__":
    from pdcd.presenter.process import main

    raise SystemExit(main(int(sys.argv[1])))
