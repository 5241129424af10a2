"""The probing matrix, wanted and realised: what a goal asks for, what two panels with delays and
leaks made of it, and how far one is from the other.
"""
