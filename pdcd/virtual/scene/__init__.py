"""Virtual scenes: light transport as a sum of effects, each in its cheapest form, and what a camera
sees of it.
"""
