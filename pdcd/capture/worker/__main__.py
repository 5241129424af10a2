"""`python -m pdcd.capture.worker FD`: the work process, on one end of a socket pair."""

import sys

if __name__ == "__main__":
    # Before the imports that follow, which take long.
    from pdcd.capture.worker.limits import confine

    confine()
    from pdcd.capture.worker.process import main

    raise SystemExit(main(int(sys.argv[1])))
