"""From a request to a plan, and what the plan is worth: schedule, codes, exposures, aperture, and
the predicted error for a known scene or an unknown one.
"""
