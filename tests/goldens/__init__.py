"""Goldens: everything the program produces, kept by one tree and compared with that of another.

A refactoring must not change one byte of any result. `python -m tests.goldens take FOLDER` has the
tree that it runs in take every case, and keeps what came out as plain files; `compare` lists what
differs between two such folders. `make goldens BASE=REV` does both for a commit and the working
tree. Goldens are not committed: they are equal byte for byte on one machine only.

    case.py       a case, the place it works in, and what it keeps
    program.py    the command line, called in this process
    keep.py       run folders and calibrations, as goldens
    masks.py      what may differ from one run to the next, each with the reason
    taking.py     all cases, in two processes
    comparing.py  what differs
    renamed.py    names that changed on purpose
    talking.py    a daemon, and a client that writes down both sides
    base.py       goldens of a commit, in a git worktree of its own
    cases/        the cases themselves
    devices.py    the only file that reaches into drivers and their test rigs
"""
