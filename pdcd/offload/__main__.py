"""`python -m pdcd.offload FD BYTES`: the work process, on one end of a socket pair, with so much
memory."""

import sys

if __name__ == "__main__":
    # Bounded first: the imports that follow take memory, too.
    from pdcd.offload.limits import confine

    confine(int(sys.argv[2]))
    from pdcd.offload.process import main

    raise SystemExit(main(int(sys.argv[1])))
