"""The probing matrix, wanted and realised: what a goal asks for, what two panels that answer late
and leak made of it, and how far the one is from the other.
"""
