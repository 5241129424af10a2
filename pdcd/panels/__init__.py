"""What both panels are asked to show, and where it lies: patterns and their cells, schedules of a
code, passes that compensate for lost refreshes, bit planes, pixels; and the maps from the pixels of
projector, mask and camera to the one field that all three see.
"""
