"""From a goal to the shots that are to be taken, and the sums of them that answer it; nothing is
known yet of codes' bits, refreshes or seconds.
"""
