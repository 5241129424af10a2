"""From a request to a plan, and what the plan will be worth: schedule, codes, exposures, aperture,
and the error to be foreseen before a known scene or an unknown one.
"""
