"""What both panels are asked to show, and where it lies: patterns and their cells, schedules of a
code, passes that make up for lost refreshes, bit planes, pixels; and the maps that say where the
pixels of projector, mask and camera lie on the one field that all three look at.
"""
