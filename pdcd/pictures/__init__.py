"""Makes the pictures of a run folder, each with its error. Pictures are made nowhere else: not by a
capture, not by `pdcd decode`, not by a forecast.
"""
