"""Light to numbers and back: what a camera's sensor makes of light, its noise, and how samples are
read out of RAW files.
"""
