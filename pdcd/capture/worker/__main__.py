"""`python -m pdcd.capture.worker FD`: the worker, on one end of a socket pair."""

import sys

if __name__ == "__main__":
    # Before the imports that follow, which take long.
    from pdcd.child import end_with_parent

    end_with_parent()
    from pdcd.capture.worker.process import run_worker

    raise SystemExit(run_worker(int(sys.argv[1])))
