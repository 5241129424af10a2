"""From a goal to the shots that are to be taken, and the sums of them that answer it. Bits of
codes, refreshes and seconds are not known here yet.
"""
