"""`python -m pdcd.capture.worker FD`: the worker, on one end of a socket pair."""

import sys

if __name__ == "__main__":
    # Before the imports that follow, which take long.
    from pdcd.child import live_for_parent

    live_for_parent()
    from pdcd.capture.worker.process import main

    raise SystemExit(main(int(sys.argv[1])))
