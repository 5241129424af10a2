"""From what a run folder holds to its pictures, each with its error; the only place where pictures
are made, by a capture as by `pdcd decode`, and where a forecast makes its own.
"""
