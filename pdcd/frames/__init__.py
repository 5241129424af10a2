"""What both panels are asked to show, refresh by refresh, and what they showed: patterns and where
their cells lie, schedules of a code, passes that make up for lost refreshes, bit planes, pixels.
"""
